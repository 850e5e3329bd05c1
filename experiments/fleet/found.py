"""What was found on each robot, in a form in which robots can be compared."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Key = tuple[str, str]
"""An effect and where it acts."""
_STANDARD = 2 * 1.959964
"""Width of a 95 % interval, in standard errors."""
_COMPONENTS = ("x", "y", "z")


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error.

    Attributes:
      value: in `unit`.
      error: standard error; NaN where the diagnosis gives no interval.
      unit: SI.
    """

    value: float
    error: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 %."""
        return self.value - _STANDARD / 2 * self.error, self.value + _STANDARD / 2 * self.error


@dataclass(frozen=True)
class Found:
    """One robot's diagnosis.

    Attributes:
      verdict: of the diagnosis.
      explanation: its sentences.
      effects: by effect and place, its parameters; those of several components one by one.
      read_as: effects that the robot's own recordings cannot tell from others, and that other robots decide.
    """

    verdict: str
    explanation: str
    effects: dict[Key, dict[str, Estimate]]
    read_as: tuple[Key, ...] = field(default=())


def found_of(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Found]:
    """Each robot's effects. Where its recordings leave several candidates, that which most other robots have is taken:
    `read_as` names it. Where none has any of them, it is the diagnosis's own first.

    Args:
      tables: the contents of `diagnosis.json`, by robot.
    """
    sure = {robot: _sure(table) for robot, table in tables.items()}
    support = Counter(key for effects in sure.values() for key in effects)
    return {robot: _found(table, sure[robot], support) for robot, table in tables.items()}


def _choices(table: Mapping[str, Any]) -> list[list[dict[Key, dict[str, Estimate]]]]:
    """Of every ambiguity its candidates, without what is in all of them; the diagnosis's own comes first."""
    out = []
    for entry in table["ambiguous"]:
        candidates = [_effects(candidate) for candidate in entry["candidates"]]
        common = set.intersection(*(set(c) for c in candidates))
        out.append([{key: value for key, value in c.items() if key not in common} for c in candidates])
    return out


def _sure(table: Mapping[str, Any]) -> dict[Key, dict[str, Estimate]]:
    """The effects that nothing else could be."""
    doubted = {key for candidates in _choices(table) for key in candidates[0]}
    return {key: value for key, value in _effects(table["effects"]).items() if key not in doubted}


def _found(table: Mapping[str, Any], sure: dict[Key, dict[str, Estimate]], support: Counter[Key]) -> Found:
    effects, read_as = dict(sure), []
    for candidates in _choices(table):
        chosen = max(candidates, key=lambda c: sum(support[key] for key in c))
        effects |= chosen
        if sum(support[key] for key in chosen):
            read_as += list(chosen)
    return Found(table["verdict"], table["explanation"], effects, tuple(read_as))


def _effects(rows: list[Mapping[str, Any]]) -> dict[Key, dict[str, Estimate]]:
    return {(row["id"], row["at"]): _parameters(row["id"], row["parameters"]) for row in rows}


def _parameters(effect: str, entries: Mapping[str, Any]) -> dict[str, Estimate]:
    out: dict[str, Estimate] = {}
    for name, entry in entries.items():
        values, lows, highs = (_listed(entry[end]) for end in ("value", "low", "high"))
        several = len(values) > 1
        for i, (value, low, high) in enumerate(zip(values, lows, highs, strict=True)):
            if value is None:
                continue
            error = math.nan if low is None or high is None else (high - low) / _STANDARD
            part = f"{name} {_COMPONENTS[i] if len(values) == 3 else i}" if several else name
            out[part] = Estimate(float(value), error, entry["unit"])
    return _alike(effect, out)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _alike(effect: str, found: dict[str, Estimate]) -> dict[str, Estimate]:
    """One form of effects that have two: a wave of negative amplitude, a turn by a negative angle."""
    if effect == "cogging_torque" and found["amplitude"].value < 0 and "phase" in found:
        amplitude, phase = found["amplitude"], found["phase"]
        shifted = Estimate(phase.value + math.pi, phase.error, phase.unit)
        return {**found, "amplitude": _negative(amplitude), "phase": shifted}
    if effect == "gravity_tilt" and found["angle"].value < 0:
        return {name: _negative(e) for name, e in found.items()}
    return found


def _negative(e: Estimate) -> Estimate:
    return Estimate(-e.value, e.error, e.unit)


def on_one_turn(name: str, estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """A parameter's estimates by robot; phases, each within half a turn of their circular mean."""
    if name != "phase":
        return dict(estimates)
    middle = float(np.angle(np.mean([np.exp(1j * e.value) for e in estimates.values()])))
    turned = {robot: middle + math.remainder(e.value - middle, 2 * math.pi) for robot, e in estimates.items()}
    return {robot: Estimate(turned[robot], e.error, e.unit) for robot, e in estimates.items()}
