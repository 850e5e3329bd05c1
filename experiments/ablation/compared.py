"""Answers with and without a rule, case by case, marked against what was hidden."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from experiments.ablation.one import ALL
from experiments.blind.scoring.marks import judge
from experiments.blind.scoring.score import read_report

NEEDED_BY = 0.02
"""Probability of as many worse answers among those that changed in their mark, if worse were as likely as better, below
which a rule is known to be needed."""


@dataclass(frozen=True)
class Case:
    """A blind case, and where it is: its folder, and the file of its answer."""

    folder: Path
    answer: Path

    @property
    def name(self) -> str:
        return f"{self.folder.parent.parent.name}_{self.folder.name}"


def cases_of(folders: tuple[Path, ...]) -> list[Case]:
    """All cases of folders that `experiments.blind build` wrote; ValueError where a folder holds none."""
    out = []
    for folder in folders:
        found = sorted(p.parent for p in (folder.resolve() / "cases").glob("*/model.xml"))
        if not found:
            raise ValueError(f"no cases in {folder}: expected cases/<case>/model.xml and answers/<case>.json")
        out += [Case(c, folder.resolve() / "answers" / f"{c.name}.json") for c in found]
    return out


def place(out: Path, rule: str, case: Case) -> Path:
    """The folder of one diagnosis."""
    return out / rule.replace(" ", "_") / case.name


def note(out: Path, rule: str, case: Case) -> Path:
    """The file that one diagnosis has once it was run, with whatever result."""
    return place(out, rule, case) / "run.json"


def report_of(out: Path, rule: str, case: Case) -> dict[str, Any] | None:
    """What that diagnosis said; None where it failed."""
    status = json.loads(note(out, rule, case).read_text())["status"]
    return read_report(place(out, rule, case) / "report", status)


def acted(out: Path, case: Case) -> set[str]:
    """Rules that changed an answer of the function where they act."""
    path = place(out, ALL, case) / "report" / "acted.json"
    return set(json.loads(path.read_text())) if path.exists() else set()


def public(out: Path, key: str) -> Path:
    """The file with the rules that acted on a public machine."""
    return out / "public" / f"{key}.json"


def said(report: dict[str, Any] | None) -> Any:
    """Verdict, names and places of a report: what makes two answers the same."""
    if report is None:
        return None
    named = sorted((e["id"], e["at"]) for e in report["effects"])
    either = [
        sorted(sorted((e["id"], e["at"]) for e in c) for c in g["candidates"]) for g in report["ambiguous"]
    ]
    at = (report["unexplained"] or {}).get("at")
    return report["verdict"], named, sorted(either), at


def value(case: Case, report: dict[str, Any] | None) -> tuple[float, int]:
    """What an answer is worth: its mark, then how few certain wrong names it has."""
    mark = judge(json.loads(case.answer.read_text()), report, 0.0)
    return mark.exact, -len(mark.wrong)


@dataclass(frozen=True)
class Effect:
    """What a rule does to the answers.

    Attributes:
        cases: in which it acted. run: of these, diagnosed without it. changed: with another answer. better, worse: of
            the answers with the rule, by their marks.
    """

    cases: int
    run: int
    changed: int
    better: int
    worse: int

    @property
    def needed(self) -> bool:
        """Whether it is known that answers are better with it."""
        changed = self.better + self.worse
        return changed > 0 and binomtest(self.better, changed, alternative="greater").pvalue < NEEDED_BY


def effect(out: Path, rule: str, acts: dict[Case, set[str]]) -> Effect:
    """What one rule does to the cases that were diagnosed so far; `acts`: which rules acted in each (`acted`)."""
    within = [c for c, rules in acts.items() if rule in rules]
    ran = [c for c in within if note(out, rule, c).exists()]
    changed = better = worse = 0
    for c in ran:
        with_it, without_it = report_of(out, ALL, c), report_of(out, rule, c)
        if said(with_it) == said(without_it):
            continue
        changed += 1
        a, b = value(c, with_it), value(c, without_it)
        better, worse = better + (a > b), worse + (a < b)
    return Effect(len(within), len(ran), changed, better, worse)
