"""A fleet now against the same fleet before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy import stats

from experiments.fleet.comparison import Fleet
from experiments.fleet.found import Estimate, Found, Key
from experiments.fleet.pooling import LEVEL, pool


def changes_of(fleet: Fleet, before: dict[str, Found], failed_before: dict[str, str]) -> dict[str, Any]:
    """What changed, robots with most changes first.

    A parameter changed where chance explains the difference of two estimates less often than once in twenty fleets that
    stayed as they were (Bonferroni over all that are compared). The whole fleet's parameter changed where that is so of
    the mean over its robots of such differences.

    Args:
      fleet: now.
      before, failed_before: the robots of the earlier fleet.
    """
    both = [robot for robot in fleet.found if robot in before]
    steps = {robot: list(_steps(before[robot], fleet.found[robot])) for robot in both}
    together = list(_together(fleet, steps))
    count = sum(map(len, steps.values())) + len(together)
    level = LEVEL / max(count, 1)
    robots = [_robot(robot, before[robot], fleet.found[robot], steps[robot], level) for robot in both]
    changed = [r for r in robots if r["new"] or r["gone"] or r["parameters"] or len(set(r["verdict"])) > 1]
    return {
        "compared": {"robots": len(both), "parameters": count},
        "fleet": [step for step in together if step["chance"] < level],
        "robots": sorted(changed, key=_size, reverse=True),
        "joined": [robot for robot in fleet.found if robot not in before and robot not in failed_before],
        "left": [r for r in (*before, *failed_before) if r not in fleet.found and r not in fleet.failed],
        "failing_now": [robot for robot in fleet.failed if robot in before],
        "diagnosed_again": [robot for robot in fleet.found if robot in failed_before],
    }


def _steps(old: Found, new: Found) -> Iterator[tuple[Key, str, Estimate, Estimate]]:
    """Parameters of which a robot has two estimates: the old one, and the step from it to the new one."""
    for key, parameters in new.effects.items():
        for name, estimate in parameters.items():
            was = old.effects.get(key, {}).get(name)
            if was is not None and estimate.error > 0 and was.error > 0:
                step = estimate.value - was.value
                if name == "phase":
                    step = math.remainder(step, 2 * math.pi)
                yield key, name, was, Estimate(step, math.hypot(estimate.error, was.error), was.unit)


def _robot(
    robot: str, old: Found, new: Found, steps: list[tuple[Key, str, Estimate, Estimate]], level: float
) -> dict[str, Any]:
    moved = [_row(*each, 2 * float(stats.norm.sf(abs(each[3].value / each[3].error)))) for each in steps]
    return {
        "robot": robot,
        "verdict": [old.verdict, new.verdict],
        "new": [list(key) for key in new.effects if key not in old.effects],
        "gone": [list(key) for key in old.effects if key not in new.effects],
        "parameters": [row for row in moved if row["chance"] < level],
    }


def _row(key: Key, name: str, was: Estimate, step: Estimate, chance: float) -> dict[str, Any]:
    return {
        "id": key[0],
        "at": key[1],
        "parameter": name,
        "before": was.value,
        "now": was.value + step.value,
        "unit": was.unit,
        "chance": chance,
    }


def _together(
    fleet: Fleet, steps: dict[str, list[tuple[Key, str, Estimate, Estimate]]]
) -> Iterator[dict[str, Any]]:
    """The mean step of every shared parameter over the robots, of two at least."""
    shared = {effect.key for effect in fleet.effects if effect.shared}
    groups: dict[tuple[Key, str], list[tuple[Estimate, Estimate]]] = {}
    for each in steps.values():
        for key, name, was, step in each:
            if key in shared:
                groups.setdefault((key, name), []).append((was, step))
    for (key, name), pairs in groups.items():
        if len(pairs) < 2:
            continue
        y, s = (np.array([getattr(step, field) for _, step in pairs]) for field in ("value", "error"))
        mean = pool(y, s, interval=False)
        chance = 2 * float(stats.t.sf(abs(mean.value / mean.error), len(pairs) - 1))
        unit = pairs[0][0].unit
        usual = Estimate(float(np.mean([old.value for old, _ in pairs])), math.nan, unit)
        step = Estimate(mean.value, mean.error, unit)
        yield _row(key, name, usual, step, chance) | {"robots": len(pairs)}


def _size(robot: dict[str, Any]) -> tuple[int, float]:
    count = len(robot["new"]) + len(robot["gone"]) + len(robot["parameters"])
    return count, -min((p["chance"] for p in robot["parameters"]), default=1.0)
