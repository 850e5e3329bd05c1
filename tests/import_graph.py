"""The project's imports, read from the source: which rooms there are, and the picture of them in docs/architecture.md.

python -m tests.import_graph   # draws the picture anew
"""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("envs", "mpge_jax", "experiments")
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- drawn by python -m tests.import_graph -->", "<!-- end of what is drawn -->"

D, B = "mpge_jax.diagnosis", "experiments.blind"
SECOND = "experiments.second_author"
ROOMS = (
    "mpge_jax.commands", "mpge_jax.own_code", "envs", "mpge_jax.own_envs",
    "mpge_jax.files", "mpge_jax.progress", "mpge_jax.sharding", "mpge_jax.loop",
    "mpge_jax.learning", "mpge_jax.rollouts", "mpge_jax.grounding",
    f"{D}.errors", f"{D}.config", f"{D}.thresholds",
    f"{D}.machine", f"{D}.recordings", f"{D}.effects", f"{D}.own_effects", f"{D}.simulation", f"{D}.estimation",
    f"{D}.dataset",
    f"{D}.evidence", f"{D}.force_balance", f"{D}.selection", f"{D}.measurement", f"{D}.drives",
    f"{D}.residual", f"{D}.verdict",
    "mpge_jax.task_files", f"{D}.corrected", f"{D}.report", f"{D}.inspection", f"{D}.diagnosis", f"{D}.pipeline", D,
    "mpge_jax.recorded", "mpge_jax",
    "experiments.ending", "experiments.marked_page", "experiments.command_line", "experiments.runners",
    f"{B}.vocabulary", f"{B}.robots", f"{B}.truth", f"{B}.visibility", f"{B}.draws", f"{B}.case", f"{B}.wishes",
    f"{B}.circumstances", f"{B}.build", f"{B}.told", f"{B}.run", f"{B}.scoring", B,
    SECOND, "experiments.fleet", "experiments", "experiments.scale", "experiments.benchmark.peers",
)  # fmt: skip
"""Packages, and modules beside packages, from the lowest to the highest: each may import those before it. A package
that stands behind its own parts holds what is left of it: the names that it gives to others."""


def module_files(root: Path = ROOT) -> dict[str, Path]:
    """Maps each module's dotted name to its file; a package goes by the name of its folder."""
    files = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def imports_of(module: str, source: str, *, is_package: bool, known: frozenset[str]) -> set[str]:
    """The modules among `known` that `source` names in an import: those inside of functions and those for the type
    checker alone are counted too."""
    found = set()
    for node in ast.walk(ast.parse(source)):
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
    """Module to the modules that it imports."""
    files = module_files(root)
    known = frozenset(files)
    return {
        module: imports_of(module, path.read_text("utf-8"), is_package=path.stem == "__init__", known=known)
        for module, path in files.items()
    }


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def room_of(module: str) -> str:
    """The smallest of `ROOMS` that holds a module."""
    return max((room for room in ROOMS if within(module, room)), key=len)


def arrows(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Room to the other rooms that it imports."""
    out: dict[str, set[str]] = {room: set() for room in ROOMS}
    for module, targets in graph.items():
        out[room_of(module)] |= {room_of(t) for t in targets} - {room_of(module)}
    return out


def direct(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The same without the arrows that longer ways imply."""

    def reached(room: str) -> set[str]:
        return graph[room].union(*map(reached, graph[room]))

    return {room: targets - set().union(*map(reached, targets)) for room, targets in graph.items()}


def drawn(graph: dict[str, set[str]], files: dict[str, Path]) -> str:
    """The rooms as a Mermaid picture, and as a table with the first line of each one's docstring."""
    name = {room: room.replace(".", "_") for room in ROOMS}
    lines = ["```mermaid", "flowchart BT"]
    for title, package in (("mpge_jax.diagnosis", D), ("experiments.blind", B)):
        lines.append(f'  subgraph {package.replace(".", "_")}_rooms["{title}"]')
        lines += [f'    {name[r]}["{r.removeprefix(package + ".")}"]' for r in ROOMS if within(r, package)]
        lines.append("  end")
    lines += [f'  {name[r]}["{r}"]' for r in ROOMS if not within(r, D) and not within(r, B)]
    arrow = direct(arrows(graph))
    lines += [f"  {name[t]} --> {name[r]}" for r in ROOMS for t in sorted(arrow[r], key=ROOMS.index)]
    lines += ["```", "", "| room | what it is for |", "|---|---|"]
    for room in reversed(ROOMS):
        about = (ast.get_docstring(ast.parse(files[room].read_text("utf-8"))) or "").partition("\n\n")[0]
        lines.append(f"| `{room.replace('.', '/')}` | {' '.join(about.split())} |")
    return "\n".join(lines)


def page(text: str, picture: str) -> str:
    """The page with the picture put where it belongs."""
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    return f"{before}{BEGIN}\n{picture}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text("utf-8"), drawn(import_graph(), module_files())), "utf-8")
