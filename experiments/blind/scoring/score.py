"""The table of marks over all cases, by effect, by machine and by concealment, as Markdown and JSON."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from experiments.blind.scoring.marks import Mark, judge
from experiments.blind.vocabulary import PARAMETERS

REPORTING = 100  # seeds below are for building and tuning
BEGIN, END = "<!-- begin of blind score -->", "<!-- end of blind score -->"


def load_marks(answers: Path, runs: Path, alone: Path | None = None) -> list[Mark]:
    """Mark every answered case that was run.

    Args:
        alone: the same runs of some of the cases once more, by themselves on the machine: their times count.

    Raises:
        FileNotFoundError: there is no run. ValueError: a run in `alone` answered otherwise.
    """
    marks = []
    for path in sorted(answers.glob("case_*.json")):
        answer = json.loads(path.read_text())
        note = runs / answer["case"] / "run.json"
        if not note.exists():
            continue
        run = json.loads(note.read_text())
        report = _report(runs / answer["case"] / "report", run["status"])
        if alone is not None and (again := alone / answer["case"] / "run.json").exists():
            run = json.loads(again.read_text())
            if _report(again.parent / "report", run["status"]) != report:
                raise ValueError(
                    f"{again.parent} answers otherwise than {note.parent}; time the same revision."
                )
        marks.append(judge(answer, report, run["seconds"]))
    if not marks:
        raise FileNotFoundError(f"no runs in {runs} belong to the answers in {answers}")
    return marks


def _report(folder: Path, status: int | None) -> dict | None:
    path = folder / "diagnosis.json"
    if status != 0 or not path.exists():
        return None
    try:
        report = json.loads(path.read_text())
    except json.JSONDecodeError:
        return None
    return report if isinstance(report, dict) else None


def summary(marks: list[Mark]) -> dict[str, dict]:
    """The figures of the table: {"figure": {"value", "of" (cases or parameters), "mark", "passed"}}."""
    by = {
        kind: [m for m in marks if m.kind == kind] for kind in ("single", "pair", "triple", "null", "unknown")
    }
    single = by["single"]
    parameters = [p for m in single if m.exact > 0 for p in m.parameters]
    intervals = [x for m in marks if m.exact > 0 for p in m.parameters for x in p.contained]
    drops = [m.drop for m in single if m.drop is not None]
    seconds = [m.seconds for m in marks]
    share: Callable[[list], float | None] = lambda xs: float(np.mean(xs)) if xs else None  # noqa: E731
    rows = {
        "effect and place exactly named": (share([m.exact for m in single]), len(single), "at least 0.90"),
        "right place": (share([m.place for m in single]), len(single), "at least 0.97"),
        "parameters within 10 %": (share([p.within for p in parameters]), len(parameters), "at least 0.85"),
        "95 % intervals contain the truth": (share(intervals), len(intervals), "0.90 to 0.98"),
        "two effects, both right": (share([m.exact for m in by["pair"]]), len(by["pair"]), "at least 0.80"),
        "three effects, all right": (share([m.exact for m in by["triple"]]), len(by["triple"]), ""),
        "effect reported on a null case": (
            share([m.alarm for m in by["null"]]),
            len(by["null"]),
            "at most 0.01",
        ),
        "null case with any verdict but none": (
            share([m.verdict != "none" for m in by["null"]]),
            len(by["null"]),
            "",
        ),
        "unknown physics unexplained, right place": (
            share([m.located for m in by["unknown"]]),
            len(by["unknown"]),
            "at least 0.90",
        ),
        "held-out error before / after, median": (
            float(np.median(drops)) if drops else None,
            len(drops),
            "at least 10",
        ),
        "seconds a case, median": (float(np.median(seconds)), len(seconds), "at most 60"),
        "seconds a case, worst": (float(np.max(seconds)), len(seconds), "at most 180"),
        "runs that failed": (share([m.failed for m in marks]), len(marks), "at most 0"),
    }
    return {
        name: {"value": value, "of": count, "mark": mark, "passed": _passed(value, mark)}
        for name, (value, count, mark) in rows.items()
    }


def _passed(value: float | None, mark: str) -> bool | None:
    if value is None or not mark:
        return None
    if " to " in mark:
        low, high = map(float, mark.split(" to "))
        return low <= value <= high
    limit = float(mark.split()[-1])
    return value >= limit if mark.startswith("at least") else value <= limit


def by_effect(marks: list[Mark]) -> dict[str, dict]:
    """Single-effect and unknown cases by their effect, with what was answered instead."""
    table = {}
    groups: dict[str, list[Mark]] = {name: [] for name in PARAMETERS}
    for m in marks:
        if m.kind in ("single", "unknown"):
            groups.setdefault(m.truth[0][0], []).append(m)
    for name, group in groups.items():
        if not group:
            continue
        parameters = [p for m in group if m.exact > 0 for p in m.parameters]
        contained = [x for p in parameters for x in p.contained]
        drops = [m.drop for m in group if m.drop is not None]
        table[name] = {
            "cases": len(group),
            "exact": float(np.mean([m.exact for m in group])),
            "place": float(np.mean([m.place for m in group])),
            "within": float(np.mean([p.within for p in parameters])) if parameters else None,
            "contained": float(np.mean(contained)) if contained else None,
            "drop": float(np.median(drops)) if drops else None,
            "instead": dict(Counter(m.answer for m in group if m.exact < 1).most_common()),
        }
    return table


def shares(marks: list[Mark], labels: Callable[[Mark], list[str]]) -> dict[str, dict]:
    """Full or half marks of all cases by label (machine, concealment)."""
    table: dict[str, list[float]] = {}
    for m in marks:
        for label in labels(m):
            table.setdefault(label, []).append(m.exact)
    return {label: {"cases": len(x), "exact": float(np.mean(x))} for label, x in sorted(table.items())}


def concealment(mark: Mark) -> list[str]:
    """Kinds of concealment without their numbers; noise in decades."""
    words = []
    for way in mark.concealed:
        if way.startswith("noise"):
            size = float(way.split()[1])
            words.append(
                "noise below 1e-4"
                if size < 1e-4
                else "noise 1e-4 to 1e-3"
                if size < 1e-3
                else "noise above 1e-3"
            )
        elif way.startswith("encoder"):
            words.append("encoder steps")
        elif not way.startswith("true step"):
            words.append(way)
    return words


def write_score(answers: Path, runs: Path, out: Path, alone: Path | None = None) -> str:
    """Mark all cases (`load_marks`), write OUT/score.json and OUT/score.md, and return the Markdown."""
    marks = load_marks(answers, runs, alone)
    plan_file = answers / "plan.json"
    plan = json.loads(plan_file.read_text()) if plan_file.exists() else {}
    tables = {
        "plan": plan,
        "answered": len(list(answers.glob("case_*.json"))),
        "alone": sum((alone / m.case / "run.json").exists() for m in marks) if alone else 0,
        "summary": summary(marks),
        "by_effect": by_effect(marks),
        "by_model": shares(marks, lambda m: [m.model]),
        "by_concealment": shares(marks, concealment),
        "cases": [asdict(m) for m in marks],
    }
    out.mkdir(parents=True, exist_ok=True)
    (out / "score.json").write_text(json.dumps(tables, indent=1, default=float))
    text = markdown(tables, marks)
    (out / "score.md").write_text(text)
    return text


def put_into(page: Path, text: str) -> None:
    """Replace what lies between the marks `BEGIN` and `END` of a Markdown page by a score, its headings two lower.

    Raises:
        ValueError: the page does not hold both marks, in this order.
    """
    old = page.read_text(encoding="utf-8")
    head, found, rest = old.partition(BEGIN)
    _, closed, tail = rest.partition(END)
    if not found or not closed:
        raise ValueError(
            f"{page} has no '{BEGIN}' followed by '{END}'; add both lines where the score shall stand."
        )
    lower = "\n".join("##" + line if line.startswith("#") else line for line in text.strip().splitlines())
    partial = page.with_suffix(".partial")
    partial.write_text(f"{head}{BEGIN}\n\n{lower}\n\n{END}{tail}", encoding="utf-8")
    partial.replace(page)


def markdown(tables: dict, marks: list[Mark]) -> str:
    """The report to read."""
    number: Callable[[float | None], str] = lambda x: "" if x is None else f"{x:.3g}"  # noqa: E731
    lines = [
        f"# Blind benchmark: {len(marks)} of {tables['answered']} cases, {_seed(tables['plan'].get('seed'))}",
        "",
        "| figure | mark | measured | of | |",
        "|---|---|---|---|---|",
    ]
    for name, row in tables["summary"].items():
        verdict = {True: "met", False: "missed", None: ""}[row["passed"]]
        lines.append(f"| {name} | {row['mark']} | {number(row['value'])} | {row['of']} | {verdict} |")
    if tables["alone"]:
        lines += [
            "",
            f"Seconds: the times of {tables['alone']} of them are from a second run, alone on the machine.",
        ]
    lines += [
        "",
        "## By effect (one effect a case)",
        "",
        "| effect | cases | exact | place | within 10 % | interval holds | error before / after | answered instead |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, row in tables["by_effect"].items():
        instead = "; ".join(f"{_cell(a)} ({n})" if n > 1 else _cell(a) for a, n in row["instead"].items())
        cells = [str(row["cases"])]
        cells += [number(row[key]) for key in ("exact", "place", "within", "contained", "drop")]
        lines.append(f"| {name} | {' | '.join(cells)} | {instead} |")
    for title, key in (("machine", "by_model"), ("concealment", "by_concealment")):
        lines += ["", f"## By {title} (all cases)", "", f"| {title} | cases | exact |", "|---|---|---|"]
        lines += [f"| {name} | {row['cases']} | {row['exact']:.2f} |" for name, row in tables[key].items()]
    lines += [
        "",
        "## Every case without full mark",
        "",
        "| case | machine | hidden | answered | mark |",
        "|---|---|---|---|---|",
    ]
    for m in marks:
        if m.exact < 1:
            truth = " + ".join(f"{name}@{at}" for name, at in m.truth) or "nothing"
            lines.append(f"| {m.case} | {m.model} | {truth} | {_cell(m.answer)} | {m.exact:g} |")
    return "\n".join(lines) + "\n"


def _seed(seed: int | None) -> str:
    """The seed and what it is for."""
    if seed is None:
        return "seed unknown"
    return f"seed {seed} ({'reporting' if seed >= REPORTING else 'building, not for reporting'})"


def _cell(text: str) -> str:
    return text.replace("|", "or")
