"""docs/atlas.md and its picture, from the rows that are kept."""

import json
import math
import statistics
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.atlas import record
from experiments.atlas.machines import MACHINES, Machine
from mpge_jax import files
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, MEASURED, NOMINAL, log_scale, save
from mpge_jax.diagnosis.verdict.part_of_unknown import UNKNOWN

LESS = 1.05
"""Times by which an error falls of which that is said."""
PICTURE = "images/atlas.png"
LEARNT = "learnable"
"""File, among those of the machines, of what `learnable` wrote."""
HEAD = """# Atlas of public machines

Written by `python -m experiments.atlas` from [results/atlas](results/atlas). Every machine is real hardware whose
recordings are public, diagnosed as they come, with no setting of its own. Errors are root mean squares over held-out
recordings that no fit and no choice has seen: of the force that a motion needs, or of the motion that is predicted
over windows. *After* is with what is named, and where functions of what has no name help, with these too; by how much
the error falls, and the reference, are of what is named alone. The sizes of the effects, their intervals and what is
left over stand on the machine's page (the link).
*Reference*: what an expert's plain fit reached on the same recordings, of forces; met within 1.1 times. Of motions it
is 1.1 times what the fit reached.
"""
LAYOUT = """`python -m experiments.atlas --recordings DIR` reads them from folders of DIR with these names, each with
`model.xml` and the recordings, `heldout_*` among them where some only judge. The outermost of these folders holds a
`README.txt` with the lines `Source repo: ...` and `License: ...`, which this table repeats.
"""
Row = dict[str, Any]


def rows(docs: Path) -> dict[str, Row]:
    """What is kept of each machine, in the order of the list.

    Raises:
      FileNotFoundError: nothing was diagnosed yet.
    """
    found = {key: record.kept(docs, key) for key in MACHINES}
    read = {key: json.loads(file.read_text("utf-8")) for key, file in found.items() if file.is_file()}
    if not read:
        raise FileNotFoundError(f"no machine was diagnosed yet in {docs / 'results' / 'atlas'}")
    return read


def write(docs: Path) -> None:
    """The page and its picture."""
    files.write_text(docs / "atlas.md", text(docs))
    draw(rows(docs), docs / PICTURE)


def text(docs: Path) -> str:
    """The page, of all that is kept."""
    learnt = record.kept(docs, LEARNT)
    return markdown(rows(docs), json.loads(learnt.read_text("utf-8")) if learnt.is_file() else None)


def markdown(kept: Mapping[str, Row], learnt: Mapping[str, Any] | None = None) -> str:
    """The page.

    Args:
      learnt: what `learnable` wrote.
    """
    lines = [HEAD, f"![Errors after, of the models as given: {len(kept)} machines]({PICTURE})", ""]
    lines += ["| machine | its makers know | verdict | named | error before | after | | reference | time |"]
    lines += ["|---|---|---|---|--:|--:|--:|---|--:|"]
    for key, row in kept.items():
        cells = [f"[{MACHINES[key].title}](machines/{key}.md)", MACHINES[key].known, f"`{row['verdict']}`"]
        cells += [_named(row), f"{row['before']:.3g} {row['unit']}", _after(row)]
        cells += [
            f"{row['before'] / row['after']:.3g} times less"
            if row["after"] * LESS < row["before"]
            else "no less"
        ]
        cells += [_beside(MACHINES[key], row), f"{row['seconds']} s"]
        lines.append(f"| {' | '.join(cells)} |")
    verdicts = Counter(row["verdict"] for row in kept.values())
    told = ", ".join(f"{count} `{verdict}`" for verdict, count in verdicts.most_common())
    lines += ["", f"Verdicts: {told}. {_met_in_all(kept)}"]
    if missing := [MACHINES[key].title for key in MACHINES if key not in kept]:
        lines += ["", f"Not diagnosed yet: {', '.join(missing)}."]
    lines += [] if learnt is None else _learnt(learnt, kept)
    lines += ["", "## Where the recordings come from", "", LAYOUT]
    lines += ["| machine | folder | source | licence |", "|---|---|---|---|"]
    lines += [
        f"| {MACHINES[k].title} | `{MACHINES[k].folder}` | {r['source']} | {r['licence']} |"
        for k, r in kept.items()
    ]
    lines += ["", _made(kept), ""]
    return "\n".join(lines)


def _after(row: Row) -> str:
    """The error with what is named, and with the functions of what has no name, where these help."""
    named = f"{row['after']:.3g} {row['unit']}"
    return (
        named if row["with_residual"] is None else f"{named}; with its functions {row['with_residual']:.3g}"
    )


def _learnt(found: Mapping[str, Any], kept: Mapping[str, Row]) -> list[str]:
    """What strong learners leave of what the diagnoses leave: lines of the page, from what `learnable` wrote; and what
    the diagnoses' own functions leave of it."""
    lines = [
        "",
        "## Could more of it be learnt?",
        "",
        "Of the missing force of test recordings (its rms), the share that is left by the best of two learners of any "
        "shape, gradient-boosted and extremely randomised trees of scikit-learn, given positions, speeds, for how long "
        "and how far each joint has moved since it turned, commands, and time: of the joint itself, or of all. Which "
        "is best was chosen by the same test recordings, which flatters it; 1 and more: nothing was learnt that holds "
        "there. *Residual*: error of the test recordings with the diagnosis's own functions of what is left, over that "
        "without (`-`: they did not help, and were dropped).",
        "",
        f"`python -m experiments.atlas.learnable --recordings DIR`, commit "
        f"{', '.join(sorted({row['commit'] for row in found.values()}))}; scikit-learn comes with the group `peers`.",
        "",
        "| machine | left by the best learner, by joint or motor | residual |",
        "|---|---|--:|",
    ]
    for key, row in found.items():
        left = ", ".join(f"{x:.2f}" for x in row["left"].values() if x is not None)
        own = kept[key]["with_residual"] if key in kept else None
        residual = "-" if own is None else f"{own / kept[key]['after']:.2f}"
        lines.append(f"| [{MACHINES[key].title}](machines/{key}.md) | {left} | {residual} |")
    return lines


def _named(row: Row) -> str:
    """Effects by kind, with the number of places; in what candidates differ that cannot be told apart; what is left."""
    kinds = Counter(kind for kind, _ in row["effects"])
    at = dict(row["effects"])
    said = [
        f"{kind.replace('_', ' ')} ({at[kind] if count == 1 else f'{count} places'})"
        for kind, count in kinds.items()
    ]
    parts: list[list[str]] = []
    for candidates in row["ambiguous"]:
        if any(kind == UNKNOWN for kind, _ in candidates[-1]):
            parts += candidates[0]
            continue
        apart = [[e for e in one if not all(e in other for other in candidates)] for one in candidates]
        rivals = [" with ".join(f"{kind.replace('_', ' ')} ({at})" for kind, at in one) for one in apart]
        said.append(" or ".join(rival or "nothing more" for rival in rivals))
    if row["left_at"]:
        which = ", ".join(f"{kind.replace('_', ' ')} ({at})" for kind, at in parts)
        also = f", of which {which} may be a part" if parts else ""
        said.append(f"something unknown ({', '.join(row['left_at'])}){also}")
    return "; ".join(said) or "nothing"


def reached(machine: Machine, row: Row) -> list[float]:
    """Errors after, in the measure and order of the machine's reference."""
    reference = machine.reference
    assert reference is not None
    each = [after for _, after in row["each"].values()]
    found = [row["median_window"][1]] if reference.of == "median" else each
    if len(found) != len(reference.errors):
        raise ValueError(f"{machine.key}: {len(found)} errors, but a reference of {len(reference.errors)}")
    return found


def _met(machine: Machine, row: Row) -> list[bool]:
    """Which errors are as good as the machine's reference; none where it has none."""
    if machine.reference is None:
        return []
    return [a <= b for a, b in zip(reached(machine, row), machine.reference.enough, strict=True)]


def _beside(machine: Machine, row: Row) -> str:
    if machine.reference is None:
        return "none"
    ours, theirs = reached(machine, row), machine.reference
    unit = {
        "force": "of the force",
        "each": "in the usual window",
        "median": f"{row['unit']} in the usual window",
    }
    near = sum(_met(machine, row))
    listed = [" ".join(f"{x:.3g}" for x in each) for each in (theirs.errors, ours)]
    met = "met" if near == len(ours) else ("**missed**" if near == 0 else f"met at {near} of {len(ours)}")
    return f"{listed[0]} {unit[theirs.of]}; here {listed[1]}: {met}"


def _met_in_all(kept: Mapping[str, Row]) -> str:
    compared = [each for each in (_met(MACHINES[key], row) for key, row in kept.items()) if each]
    met = sum(map(all, compared))
    return f"The reference is met on {met} of the {len(compared)} that have one."


def _made(kept: Mapping[str, Row]) -> str:
    commits = sorted({row["versions"]["commit"] for row in kept.values()})
    machines = sorted({row["versions"]["machine"] for row in kept.values()})
    loads = [row["load_average"] for row in kept.values()]
    jobs = sorted({row["jobs"] for row in kept.values()})
    return (
        f"Commit {', '.join(commits)}, on {', '.join(machines)}, {' or '.join(map(str, jobs))} threads, beside other "
        f"work (load average {min(loads):g} to {max(loads):g}): times are too long."
    )


def draw(kept: Mapping[str, Row], path: Path) -> Path:
    """A line for each machine: what is left of the error of the model as given, with functions of what has no name too,
    beside the reference."""
    figure = Figure(figsize=(8.6, 0.36 * len(kept) + 1.3), layout="constrained")
    ax = figure.subplots()
    series: dict[str, tuple[dict[str, Any], list[float | None]]] = {
        "model as given": ({"color": NOMINAL, "marker": "o"}, []),
        "corrected": ({"color": CORRECTED, "marker": "o"}, []),
        "with its functions": ({"color": CORRECTED, "marker": "o", "mfc": "white"}, []),
        "reference": ({"color": MEASURED, "marker": "|", "ms": 13}, []),
    }
    for y, (key, row) in enumerate(kept.items()):
        left, more = row["after"] / row["before"], row["with_residual"]
        at = (1.0, left, more and more / row["before"], _reference_over(MACHINES[key], row, left))
        ax.plot([min(left, at[2] or left), 1.0], [y, y], color="#bbbbbb", lw=2, zorder=1)
        for (_, found), x in zip(series.values(), at, strict=True):
            found.append(x)
    for name, (style, found) in series.items():
        shown = [(x, y) for y, x in enumerate(found) if x is not None]
        ax.plot(*zip(*shown, strict=True), ls="", label=name, zorder=2, **{"mew": 2, "ms": 7, **style})
    log_scale(ax)
    ax.set_yticks(range(len(kept)), [MACHINES[key].title for key in kept])
    ax.invert_yaxis()
    ax.set_xlabel("error of held-out recordings, over that of the model as given")
    ax.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, frameon=False)
    ax.grid(alpha=0.25, axis="x")
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(figure, path)


def _reference_over(machine: Machine, row: Row, left: float) -> float | None:
    """Where the reference lies beside ours: by its usual ratio to ours (geometric mean over joints)."""
    if machine.reference is None:
        return None
    pairs = zip(machine.reference.errors, reached(machine, row), strict=True)
    return left * math.exp(statistics.fmean(math.log(theirs / ours) for theirs, ours in pairs))
