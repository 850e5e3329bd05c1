"""What the robots of a fleet share, what is one robot's own, and which are odd."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from experiments.fleet.found import Estimate, Found, Key, on_one_turn
from experiments.fleet.pooling import LEVEL, Pooled, distance, pool, shrunk, standing_out

SHARED = 0.5
"""Share of the robots from which on an effect is the fleet's; two robots at least."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect over the robots that have it.

    Attributes:
      name, unit: of the parameter.
      pooled: value and spread of those that do not stand out; None where no estimate has an error.
      estimates: by robot.
      shrunk: by robot, each given the fleet too; those that stand out, and those without error, stay as they are.
      odd: how many standard deviations those that stand out are from the others.
    """

    name: str
    unit: str
    pooled: Pooled | None
    estimates: dict[str, Estimate]
    shrunk: dict[str, float]
    odd: dict[str, float]


@dataclass(frozen=True)
class Effect:
    """An effect over the fleet.

    Attributes:
      key: identifier and place.
      robots: that have it.
      without: that lack it.
      parameters: of it.
    """

    key: Key
    robots: tuple[str, ...]
    without: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    @property
    def shared(self) -> bool:
        """Whether it is the fleet's rather than some robots' own."""
        count = len(self.robots)
        return count >= 2 and count >= SHARED * (count + len(self.without))


@dataclass(frozen=True)
class Fleet:
    """All robots beside each other.

    Attributes:
      found: by robot.
      effects: those that most robots have come first.
      odd: reasons by robot, the oddest first; robots like the others are not in it.
      failed: why robots have no diagnosis.
    """

    found: dict[str, Found]
    effects: tuple[Effect, ...]
    odd: dict[str, tuple[str, ...]]
    failed: dict[str, str]


def compare(found: Mapping[str, Found], failed: Mapping[str, str]) -> Fleet:
    """Puts robots beside each other."""
    keys = Counter(key for each in found.values() for key in each.effects)
    ordered = sorted(keys, key=lambda key: (-keys[key], key))
    tried = sum(len({n for each in found.values() for n in each.effects.get(key, {})}) for key in ordered)
    effects = tuple(_effect(key, found, LEVEL / max(tried, 1)) for key in ordered)
    return Fleet(dict(found), effects, _odd(found, effects), dict(failed))


def _effect(key: Key, found: Mapping[str, Found], level: float) -> Effect:
    robots = tuple(robot for robot, each in found.items() if key in each.effects)
    without = tuple(robot for robot, each in found.items() if key not in each.effects)
    names = dict.fromkeys(name for robot in robots for name in found[robot].effects[key])
    parameters = tuple(
        _parameter(name, {r: e[name] for r in robots if name in (e := found[r].effects[key])}, level)
        for name in names
    )
    return Effect(key, robots, without, parameters)


def _parameter(name: str, estimates: dict[str, Estimate], level: float) -> Parameter:
    estimates = on_one_turn(name, estimates)
    unit = next(iter(estimates.values())).unit
    known = [robot for robot, e in estimates.items() if e.error > 0]
    values = {robot: e.value for robot, e in estimates.items()}
    if not known:
        return Parameter(name, unit, None, estimates, values, {})
    y, s = (np.array([getattr(estimates[robot], field) for robot in known]) for field in ("value", "error"))
    out = standing_out(y, s, level)
    pooled = pool(y[~out], s[~out])
    usual = [robot for robot, far in zip(known, out, strict=True) if not far]
    nearer = dict(zip(usual, map(float, shrunk(y[~out], s[~out], pooled)), strict=True))
    odd = {known[i]: distance(y[i], s[i], y[~out], s[~out]) for i in np.flatnonzero(out)}
    return Parameter(name, unit, pooled, estimates, values | nearer, odd)


def _odd(found: Mapping[str, Found], effects: tuple[Effect, ...]) -> dict[str, tuple[str, ...]]:
    reasons: dict[str, list[str]] = {robot: [] for robot in found}
    farthest = dict.fromkeys(found, 0.0)
    for effect in effects:
        for p in effect.parameters:
            for robot, far in p.odd.items():
                assert p.pooled is not None
                way = "above" if far > 0 else "below"
                farthest[robot] = max(farthest[robot], abs(far))
                reasons[robot].append(
                    f"{p.name} of {named(effect.key)} is {p.estimates[robot].value:.3g} {p.unit}, "
                    f"{abs(far):.1f} standard deviations {way} the others' {p.pooled.value:.3g}"
                )
    for effect in effects:
        total = len(effect.robots) + len(effect.without)
        for robot in effect.without if effect.shared else effect.robots if total > 1 else ():
            have = len(effect.robots)
            if effect.shared:
                reasons[robot].append(f"without {named(effect.key)}, which {have} of {total} robots have")
            else:
                others = "no other robot has" if have == 1 else f"{have - 1} of {total - 1} others have"
                reasons[robot].append(f"with {named(effect.key)}, which {others}")
    unexplained = [robot for robot, each in found.items() if each.verdict == "unexplained"]
    if len(unexplained) < SHARED * len(found):
        for robot in unexplained:
            reasons[robot].append("something is left that no effect explains; of most others it is not")
    order = sorted(reasons, key=lambda robot: (-len(reasons[robot]), -farthest[robot], robot))
    return {robot: tuple(reasons[robot]) for robot in order if reasons[robot]}


def named(key: Key) -> str:
    """'viscous damping at elbow'."""
    return f"{key[0].replace('_', ' ')} at {key[1]}"
