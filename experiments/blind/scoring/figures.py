"""The figures over all marks: shares with their intervals, by effect, by machine, by size."""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from experiments.blind.scoring.marks import SEEN, Mark
from experiments.blind.vocabulary import PARAMETERS

Z = 1.96
SIZES = (0.0, 3.0, SEEN, 50.0, 200.0, np.inf)
"""Bounds of the classes of visibility."""


def wilson(share: float, count: int) -> tuple[float, float]:
    """95 % interval of a share of `count` cases (Wilson's score interval)."""
    if count == 0:
        return 0.0, 1.0
    middle = (share + Z**2 / (2 * count)) / (1 + Z**2 / count)
    half = Z * np.sqrt(share * (1 - share) / count + Z**2 / (4 * count**2)) / (1 + Z**2 / count)
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))


def summary(marks: list[Mark]) -> dict[str, dict]:
    """The figures of the table: {"figure": {"value", "of" (cases or parameters), "mark", "passed", "interval"}}.

    What is hidden below what noise explains is left to `by_size`.
    """
    seen = [m for m in marks if m.visible]
    single, pair, triple, whole, mixed, null, unknown = (
        [m for m in seen if m.kind == kind]
        for kind in ("single", "pair", "triple", "whole", "mixed", "null", "unknown")
    )
    parameters = [p for m in single if m.exact > 0 for p in m.parameters]
    named = [p for m in marks if m.exact > 0 for p in m.parameters]
    drops = [m.drop for m in single if m.drop is not None]
    # a model that is exact as given has an error of rounding alone, before and after
    judged = [(m, max(m.judged[0], 1e-12) / max(m.judged[1], 1e-12)) for m in marks if m.judged is not None]
    gains = [gain for _, gain in judged]
    gained = [gain for m, gain in judged if m.visible and m.kind != "null"]
    shares: dict[str, tuple[Sequence[float], str]] = {
        "effect and place exactly named": ([m.exact for m in single], "at least 0.95"),
        "right place": ([m.place for m in single], "at least 0.97"),
        "parameters within 10 %": ([p.within for p in parameters], "at least 0.85"),
        "95 % intervals contain the truth": ([x for p in named for x in p.contained], "0.90 to 0.98"),
        "two effects, both right": ([m.exact for m in pair], "at least 0.85"),
        "three effects, all right": ([m.exact for m in triple], ""),
        "every joint lacks something: share named, less wrong names": ([m.exact for m in whole], ""),
        "beside unknown physics, the known part right": ([m.exact for m in mixed], "at least 0.85"),
        "cases with a certain wrong name": ([bool(m.wrong) for m in marks], "at most 0.03"),
        "effect reported on a null case": ([m.alarm for m in null], "at most 0.01"),
        "null case with any verdict but none": ([m.verdict != "none" for m in null], ""),
        "unknown physics unexplained, right place": ([m.located for m in unknown], "at least 0.90"),
        "the scorer's own recordings predicted worse, by a tenth": (
            [g < 1 / 1.1 for g in gains],
            "at most 0",
        ),
        "runs that failed": ([m.failed for m in marks], "at most 0"),
    }
    seconds = [m.seconds for m in marks]
    told = [m.judged[1] / max(m.told, 1e-12) for m in seen if m.judged and m.told and m.exact == 1]
    others: dict[str, tuple[float | None, int, str]] = {
        "error of the scorer's own recordings, before / after, median": (_median(gained), len(gained), ""),
        "the same, where all is named, over that of a rival that was told the names, median": (
            _median(told),
            len(told),
            "at most 1.1",
        ),
        "held-out error before / after, median": (_median(drops), len(drops), "at least 10"),
        "seconds a case, median": (_median(seconds), len(seconds), "at most 20"),
        "seconds a case, worst": (float(np.max(seconds)), len(seconds), "at most 180"),
    }
    table: dict[str, dict] = {}
    for name, (values, mark) in shares.items():
        value = float(np.mean(values)) if len(values) else None
        interval = None if value is None else wilson(value, len(values))
        table[name] = {"value": value, "of": len(values), "mark": mark, "interval": interval}
    for name, (value, count, mark) in others.items():
        table[name] = {"value": value, "of": count, "mark": mark, "interval": None}
    return {name: row | {"passed": _passed(row["value"], row["mark"])} for name, row in table.items()}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def by_size(marks: list[Mark]) -> list[dict]:
    """How often single effects and unknown physics are found, by how far they stand out of what noise explains."""
    hidden = [m for m in marks if m.kind in ("single", "unknown")]
    rows = []
    for low, high in pairwise(SIZES):
        here = [m for m in hidden if low <= m.seen < high]
        single = [m for m in here if m.kind == "single"]
        rows.append(
            {
                "low": low,
                "high": high,
                "single": len(single),
                "exact": float(np.mean([m.exact for m in single])) if single else None,
                "unknown": len(here) - len(single),
                "located": float(np.mean([m.located for m in here if m.kind == "unknown"]))
                if len(here) > len(single)
                else None,
                "none": float(np.mean([m.verdict == "none" for m in here])) if here else None,
                "wrong": float(np.mean([bool(m.wrong) for m in here])) if here else None,
            }
        )
    return rows


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
