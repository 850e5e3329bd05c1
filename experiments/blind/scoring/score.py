"""The table of marks over all cases, by effect, by machine and by concealment, as Markdown and JSON."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from experiments.blind.scoring.figures import by_effect, by_size, concealment, shares, summary
from experiments.blind.scoring.marks import Mark, judge
from experiments.blind.scoring.parameters import Compared
from experiments.marked_page import put_between

REPLAY = "mpge_jax.diagnosis.corrected.replay"
REPORTING = 100  # seeds below are for building and tuning
BEGIN, END = "<!-- begin of blind score -->", "<!-- end of blind score -->"


def load_marks(
    answers: Path, runs: Path, alone: Path | None = None, told: Path | None = None, kept: Path | None = None
) -> list[Mark]:
    """Mark every answered case that was run.

    Args:
        alone: the same runs of some of the cases once more, by themselves on the machine: their times count.
        told: what rivals found that were told the answer (`experiments.blind.told`).
        kept: score.json of other cases of these answers, whose runs are no more: their marks count.

    Raises:
        FileNotFoundError: there is no run. ValueError: a run in `alone` answered otherwise, or the marks in `kept` are
        of other answers.
    """
    marks, earlier = [], {} if kept is None else _kept(kept, answers)
    for path in sorted(answers.glob("case_*.json")):
        answer = json.loads(path.read_text())
        note = runs / answer["case"] / "run.json"
        if not note.exists():
            if answer["case"] in earlier:
                marks.append(earlier[answer["case"]])
            continue
        run = json.loads(note.read_text())
        report = read_report(runs / answer["case"] / "report", run["status"])
        if alone is not None and (again := alone / answer["case"] / "run.json").exists():
            run = json.loads(again.read_text())
            if read_report(again.parent / "report", run["status"]) != report:
                raise ValueError(
                    f"{again.parent} answers otherwise than {note.parent}; time the same revision."
                )
        mark = judge(answer, report, run["seconds"])
        judged = runs / answer["case"] / "judged.json"
        if report is not None and judged.exists():
            before, after = json.loads(judged.read_text())
            mark.judged = before, after
            rival = (told or runs) / answer["case"] / "judged.json"
            if told is not None and rival.exists():
                mark.told = json.loads(rival.read_text())[1]
        marks.append(mark)
    if not marks:
        raise FileNotFoundError(f"no runs in {runs} belong to the answers in {answers}")
    return marks


def _kept(file: Path, answers: Path) -> dict[str, Mark]:
    """The marks in a score.json, by case."""
    table = json.loads(file.read_text())
    if table["plan"] != _plan(answers):
        raise ValueError(f"{file} holds marks of another seed or other counts than the answers in {answers}.")
    marks = {}
    for row in table["cases"]:
        parameters = [Compared(**p | {"contained": tuple(p["contained"])}) for p in row["parameters"]]
        pairs = {name: [tuple(named) for named in row[name]] for name in ("truth", "wrong")}
        judged = None if row["judged"] is None else tuple(row["judged"])
        marks[row["case"]] = Mark(**row | pairs | {"parameters": parameters, "judged": judged})
    return marks


def _plan(answers: Path) -> dict:
    """The seed and the counts of a set of answers."""
    file = answers / "plan.json"
    return dict(json.loads(file.read_text())) if file.exists() else {}


def read_report(folder: Path, status: int | None) -> dict | None:
    """The diagnosis.json of a run that ended with `status`; None where that failed or left none."""
    path = folder / "diagnosis.json"
    if status != 0 or not path.exists():
        return None
    try:
        report = json.loads(path.read_text())
    except json.JSONDecodeError:
        return None
    return report if isinstance(report, dict) else None


def write_score(
    answers: Path,
    runs: Path,
    out: Path,
    alone: Path | None = None,
    told: Path | None = None,
    kept: Path | None = None,
) -> str:
    """Mark all cases (`load_marks`), write OUT/score.json and OUT/score.md, and return the Markdown."""
    # a process of its own: nothing here shares code with the engine that is put to the test
    for folder in (runs, told):
        if folder is not None:
            subprocess.run([sys.executable, "-m", REPLAY, str(folder), str(answers)], check=True)
    marks = load_marks(answers, runs, alone, told, kept)
    tables = {
        "plan": _plan(answers),
        "answered": len(list(answers.glob("case_*.json"))),
        "alone": sum((alone / m.case / "run.json").exists() for m in marks) if alone else 0,
        "summary": summary(marks),
        "by_size": by_size(marks),
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
    """Puts a score between the marks `BEGIN` and `END` of a Markdown page, its headings two lower."""
    lower = "\n".join("##" + line if line.startswith("#") else line for line in text.strip().splitlines())
    put_between(page, BEGIN, END, lower)


def markdown(tables: dict, marks: list[Mark]) -> str:
    """The report to read."""
    number: Callable[[float | None], str] = lambda x: "" if x is None else f"{x:.3g}"  # noqa: E731
    lines = [
        f"# Blind benchmark: {len(marks)} of {tables['answered']} cases, {_seed(tables['plan'].get('seed'))}",
        "",
        "| figure | mark | measured | 95 % interval | of | |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in tables["summary"].items():
        verdict = {True: "met", False: "missed", None: ""}[row["passed"]]
        interval = "" if row["interval"] is None else "{:.3g} to {:.3g}".format(*row["interval"])
        cells = [name, row["mark"], number(row["value"]), interval, str(row["of"]), verdict]
        lines.append(f"| {' | '.join(cells)} |")
    if tables["alone"]:
        lines += [
            "",
            f"Seconds: the times of {tables['alone']} of them are from a second run, alone on the machine.",
        ]
    lines += [
        "",
        "## By size: window error over what noise explains (one effect, or one that is not in the vocabulary)",
        "",
        "| size | single effects | exactly named | unknown | found | verdict `none` | certain wrong name |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in tables["by_size"]:
        cells = [f"{row['low']:g} to {row['high']:g}", str(row["single"]), number(row["exact"])]
        cells += [str(row["unknown"]), *(number(row[key]) for key in ("located", "none", "wrong"))]
        lines.append(f"| {' | '.join(cells)} |")
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
