"""The arrows between modules and rooms: one way, without a circle, in folders of a size that one can keep in mind."""

from collections import Counter
from graphlib import CycleError, TopologicalSorter

import pytest

from tests.import_graph import (
    PACKAGES,
    PAGE,
    ROOMS,
    ROOT,
    SECOND,
    B,
    D,
    direct,
    drawn,
    import_graph,
    imports_of,
    module_files,
    page,
    room_of,
    within,
)

MOST = 15
"""Modules in a folder."""
GRAPH = import_graph()


def reachable(start: str) -> set[str]:
    seen, todo = set(), [start]
    while todo:
        for target in GRAPH[todo.pop()] - seen:
            seen.add(target)
            todo.append(target)
    return seen


def edges(source: str, target: str) -> list[tuple[str, str]]:
    """Imports that lead from the package `source` into the package `target`, as (importer, imported)."""
    return [
        (module, imported)
        for module, imports in GRAPH.items()
        for imported in sorted(imports)
        if within(module, source) and within(imported, target)
    ]


def test_all_packages_and_rooms_are_there():
    assert {module.split(".")[0] for module in GRAPH} == set(PACKAGES)
    assert {room_of(module) for module in GRAPH} == set(ROOMS)


def test_no_import_cycles():
    try:
        TopologicalSorter(GRAPH).prepare()
    except CycleError as error:
        pytest.fail("import cycle: " + " <- ".join(error.args[1]))


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_lower_rooms_only(room):
    height = ROOMS.index(room)
    upward = [
        f"{module} -> {target}"
        for module in GRAPH
        if room_of(module) == room
        for target in GRAPH[module]
        if ROOMS.index(room_of(target)) > height
    ]
    assert upward == []


def test_the_halves_share_no_more_than_the_target_log():
    # The face of the package gives both halves' names.
    shared = edges(D, "mpge_jax.learning") + edges(D, "mpge_jax.grounding") + edges(D, "mpge_jax.rollouts")
    assert {target for _, target in shared} == {"mpge_jax.rollouts.target_log"}


def test_blind_cases_share_no_code_with_the_diagnosis():
    for module in GRAPH:
        if within(module, B):
            shared = sorted(target for target in reachable(module) if within(target, D))
            assert shared == [], f"{module} reaches the engine that it puts to the test"


def test_the_second_author_shares_code_with_neither():
    for module in GRAPH:
        if within(module, SECOND):
            shared = sorted(target for target in reachable(module) if within(target, D) or within(target, B))
            assert shared == [], f"{module} reaches what others wrote of the same physics"


@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_no_folder_holds_too_many_modules(package):
    counts = Counter(p.parent for p in (ROOT / package).rglob("*.py"))
    assert {str(folder.relative_to(ROOT)): n for folder, n in counts.items() if n > MOST} == {}


def test_no_two_test_files_have_one_name():
    """Folders of tests are no packages: pytest takes two files of one name for the same module."""
    counts = Counter(p.name for p in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, n in counts.items() if n > 1] == []


def test_every_room_has_its_tests():
    """`tests/` has the folders of the packages: what a room does is tested in the folder of that name."""
    packages = [p.parent for p in (ROOT / "mpge_jax").rglob("__init__.py")][1:]
    lacking = [
        f for f in packages if not any((ROOT / "tests" / f.relative_to(ROOT / "mpge_jax")).glob("test_*.py"))
    ]
    assert [str(f.relative_to(ROOT)) for f in lacking] == []


def test_the_picture_of_the_rooms_is_that_of_the_imports():
    text = PAGE.read_text("utf-8")
    assert page(text, drawn(GRAPH, module_files())) == text, "python -m tests.import_graph draws it anew"


def test_arrows_that_longer_ways_imply_are_not_drawn():
    assert direct({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": {"b"}, "b": {"c"}, "c": set()}


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
        ("if TYPE_CHECKING:\n    from p.a import thing", {"p.a"}),
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
