"""The arrows between modules, read from the source: parts -> learners -> algorithms -> experiments."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("envs", "mpge_jax", "experiments")

# The lower layers of `mpge_jax`, parts before learners. A module may import those of the layers before its
# own and nothing else of this project but `envs`' choice between two states. One not named here is an algorithm: it
# may import them, and `envs`.
LAYERS = (
    {"buffer", "distributions", "files", "networks", "normalise", "policy_gradient", "progress"},
    {"discriminator", "loop", "ppo", "sac", "transformer", "trpo", "value"},
)

DIAGNOSIS = "mpge_jax.diagnosis"
BLIND = "experiments.blind"


def module_files(root: Path = ROOT) -> dict[str, Path]:
    """Maps each module's dotted name to its file; a package goes by the name of its folder."""
    files = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def imports_of(module: str, source: str, *, is_package: bool, known: frozenset[str]) -> set[str]:
    """The modules among `known` that `source` names in an import, those inside of functions included.

    What stands under `if TYPE_CHECKING:` does not count: no program ever runs it.
    """
    found = set()
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                climb = node.level - is_package
                package = module.split(".")[: len(module.split(".")) - climb]
                base = ".".join([*package, *([base] if base else [])])
            targets = [(base, alias.name) for alias in node.names]
        else:
            continue
        for base, name in targets:
            # `from a.b import c` means the module a.b.c where there is one, else something defined in a.b.
            found |= {f"{base}.{name}" if f"{base}.{name}" in known else base} & known
    return found - {module}


def import_graph(root: Path = ROOT) -> dict[str, set[str]]:
    files = module_files(root)
    known = frozenset(files)
    return {
        module: imports_of(module, path.read_text("utf-8"), is_package=path.stem == "__init__", known=known)
        for module, path in files.items()
    }


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    seen, todo = set(), [start]
    while todo:
        for target in graph[todo.pop()] - seen:
            seen.add(target)
            todo.append(target)
    return seen


GRAPH = import_graph()


def edges(source: str, target: str) -> list[tuple[str, str]]:
    """Imports that lead from the package `source` into the package `target`, as (importer, imported)."""
    return [
        (module, imported)
        for module, imports in GRAPH.items()
        for imported in sorted(imports)
        if within(module, source) and within(imported, target)
    ]


def test_all_three_packages_are_seen():
    assert {module.split(".")[0] for module in GRAPH} == set(PACKAGES)


@pytest.mark.parametrize(
    ("source", "target"), [("envs", "mpge_jax"), ("envs", "experiments"), ("mpge_jax", "experiments")]
)
def test_arrows_between_packages_point_one_way(source, target):
    assert edges(source, target) == []


def test_no_import_cycles():
    try:
        TopologicalSorter(GRAPH).prepare()
    except CycleError as error:
        pytest.fail("import cycle: " + " <- ".join(error.args[1]))


@pytest.mark.parametrize("depth", range(len(LAYERS)))
def test_layers_import_lower_layers_only(depth):
    below = {f"mpge_jax.{module}" for layer in LAYERS[:depth] for module in layer}
    for module in sorted(LAYERS[depth]):
        upward = GRAPH[f"mpge_jax.{module}"] - below - {"envs.select"}
        assert upward == set(), f"mpge_jax.{module} imports what is not below it"


def test_learning_does_not_import_the_diagnosis():
    # The package itself may: `mpge_jax.diagnose` is part of its interface.
    importers = {importer for importer, _ in edges("mpge_jax", DIAGNOSIS)} - {"mpge_jax"}
    assert [importer for importer in importers if not within(importer, DIAGNOSIS)] == []


def test_blind_cases_share_no_code_with_the_diagnosis():
    for module in GRAPH:
        if within(module, BLIND):
            shared = sorted(target for target in reachable(GRAPH, module) if within(target, DIAGNOSIS))
            assert shared == [], f"{module} reaches the engine that it puts to the test"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import p.a", {"p.a"}),
        ("from p import a, thing", {"p.a", "p"}),
        ("from p.a import thing", {"p.a"}),
        ("from . import a", {"p.a"}),
        ("from .a import thing", {"p.a"}),
        ("from .sub.c import thing", {"p.sub.c"}),
        ("def f():\n    import p.a as x", {"p.a"}),
        ("import numpy\nfrom numpy import a", set()),
    ],
)
def test_imports_are_read_correctly(source, expected):
    known = frozenset({"p", "p.a", "p.b", "p.sub", "p.sub.c"})
    assert imports_of("p.b", source, is_package=False, known=known) == expected


def test_relative_imports_of_a_package_start_at_itself():
    known = frozenset({"p", "p.sub", "p.sub.c"})
    assert imports_of("p.sub", "from .c import thing", is_package=True, known=known) == {"p.sub.c"}
    assert imports_of("p.sub.c", "from .. import thing", is_package=False, known=known) == {"p"}
