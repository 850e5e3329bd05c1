"""Drawing one case: hidden physics whose size is visible over the noise but not trivially large."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from experiments.blind.draws import Place, draw
from experiments.blind.truth.machine import Machine
from experiments.blind.truth.plant import Unstable
from experiments.blind.visibility.equivalence import actuators, drive_train, twins_of
from experiments.blind.visibility.separability import distinct_share
from experiments.blind.visibility.statistics import Statistics
from experiments.blind.visibility.windows import rms, window_errors
from experiments.blind.vocabulary import Effect

WEAKEST, STRONGEST = 12.0, 250.0  # window error over what noise and time step explain, at the worst joint
DISTINCT = 4.0  # the part of it that no simpler effect can imitate
LEAST = 3e-4  # rad: with very good sensors a floor all the same, so that effects have a physical size
RANGE = 0.6  # window error over the spread of the motion, at most
SMALLEST, LARGEST = 0.2, 12.0  # sizes, 1 being typical
STILL = 0.03  # rad/s
CHAOS = 60.0  # growth of an error in a window's start, at most
SMOOTHED = 0.3  # of the measurement noise is left in a smoothed start
TRIALS = 7


class Unfit(RuntimeError):
    """No visible size was found here; draw another place or machine."""


@dataclass(frozen=True)
class Look:
    """Window errors of the nominal model on a machine with hidden physics.

    seen: over what noise and time step explain, at the worst joint; share: over the spread of the motion; distinct:
    the part of `seen` that no simpler effect can imitate.
    """

    seen: float
    share: float
    distinct: float

    @property
    def weak(self) -> bool:
        """Not visible, or not to be told from something simpler."""
        return self.seen < WEAKEST or self.distinct < DISTINCT

    @property
    def strong(self) -> bool:
        """Trivially large."""
        return self.seen > STRONGEST or self.share > RANGE


@dataclass
class Bench:
    """A machine, its nominal runs on the checking recordings, and the errors that noise and time step explain."""

    machine: Machine
    floor: np.ndarray
    spread: np.ndarray
    stats: Statistics
    found: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, machine: Machine) -> "Bench":
        """Runs the nominal machine; raises Unfit where it does not move as it should or its windows are chaotic."""
        model = machine.model
        try:
            runs = [machine.record(plan) for plan in machine.checking]
        except Unstable as reason:
            raise Unfit(str(reason)) from None
        if np.median([run.qvel[len(run.qvel) // 2 :].std(0) for run in runs]) < STILL:
            raise Unfit("the nominal machine stands still")
        errors = np.concatenate([window_errors(model, run) for run in runs])
        noise = machine.sensors.floor(model)
        nudge = np.maximum(noise, 1e-4 * machine.sensors.scale(model))
        nudged = np.concatenate([window_errors(model, run, nudge=nudge) for run in runs])
        growth = rms(nudged - errors) / nudge
        if not (growth < CHAOS).all():
            raise Unfit("the windows are chaotic")
        floor = np.sqrt(noise**2 + (SMOOTHED * noise * growth) ** 2 + rms(errors) ** 2)
        floor = np.maximum(floor, LEAST * machine.sensors.scale(model))
        spread = np.max([run.qvel.std(0) for run in runs], 0) * 0.3 + 1e-6
        return cls(machine, floor, spread, Statistics(model, runs))

    def look(self, effects: list[Effect]) -> Look | None:
        """How visible hidden physics is on the checking recordings; None when the machine runs away."""
        try:
            runs = [self.machine.record(plan, effects) for plan in self.machine.checking]
        except Unstable:
            return None
        errors = rms(np.concatenate([window_errors(self.machine.model, run) for run in runs]))
        seen = float((errors / self.floor).max())
        distinct = seen * min(distinct_share(e, self.machine.model, runs) for e in effects)
        return Look(seen, float((errors / self.spread).max()), distinct)


def place(bench: Bench, at: str, rng: np.random.Generator) -> Place:
    """A place on the bench's machine; actuators go by name or, nameless, by their joint."""
    index = actuators(bench.machine.model).get(at, -1)
    return Place(bench.machine.robot, bench.stats, at, index, bench.machine.dt, int(rng.integers(2**31)))


def draw_visible(
    bench: Bench, effect: str, at: str, rng: np.random.Generator, unknown: bool = False
) -> Effect:
    """An effect whose window error is a random number of floors; raises Unfit after a few trials."""
    where, wish = place(bench, at, rng), float(np.exp(rng.uniform(np.log(20), np.log(110))))
    size, best = 1.0, None
    for _ in range(TRIALS):
        candidate = draw(effect, where, size, unknown)
        look = bench.look([candidate])
        if look is None:
            factor = 0.4
        elif look.weak:
            factor = max(WEAKEST / look.seen, DISTINCT / max(look.distinct, 1e-3), 1.15) ** 0.8 * 1.1
        elif look.strong and effect != "dead_actuator":
            factor = min(STRONGEST / look.seen, RANGE / look.share) ** 0.8 * 0.9
        else:
            best, factor = (candidate, look.seen), (wish / look.seen) ** 0.8
            if 0.5 * wish < look.seen < 2 * wish:
                break
        size = min(max(size * min(max(factor, 0.15), 4.0), SMALLEST), LARGEST)
        if draw(effect, where, size, unknown) == candidate:
            break
    if best is None:
        raise Unfit(f"{effect} at {at} has no visible and sensible size on {bench.machine.robot.name}")
    bench.found[effect] = best[1]
    return best[0]


def draw_as_is(bench: Bench, effect: str, at: str, rng: np.random.Generator, unknown: bool = False) -> Effect:
    """An effect of the size that was drawn, a quarter to four times the typical one, visible or not.

    Raises:
        Unfit: the machine runs away with it.
    """
    size = float(np.exp(rng.uniform(np.log(0.25), np.log(4.0))))
    drawn = draw(effect, place(bench, at, rng), size, unknown)
    look = bench.look([drawn])
    if look is None or look.share > 2:
        raise Unfit("the machine runs away")
    # what no simpler effect can imitate counts as much as size
    seen = min(look.seen, look.distinct * WEAKEST / DISTINCT)
    bench.found[effect] = min(seen, bench.found.get(effect, np.inf))
    return drawn


def answer(bench: Bench, kind: str, effects: list[Effect], beside: Sequence[str] = ()) -> dict:
    """What the scorer has to know about a case (the engine never sees it).

    Args:
        beside: what else conceals the physics, in words.
    """
    machine, model = bench.machine, bench.machine.model
    known = [e for e in effects if not e.unknown]
    strange = [e for e in effects if e.unknown]
    names = {e.at for e in effects}
    twins = [twins_of(machine.robot, model, e, machine.sensors.force_noise is not None) for e in known]
    ways = [*machine.sensors.ways(), f"true step {machine.dt} s, {machine.integrator}"]
    ways += ["open loop" if machine.open_loop else "closed loop", *beside]
    return {
        "schema": 1,
        "kind": kind,
        "model": machine.robot.name,
        "plane": list(machine.robot.plane),
        "effects": [
            e.as_json() | {"twins": [list(t) for t in w.twins], "coin": w.coin, "same_place": list(w.same)}
            for e, w in zip(known, twins, strict=True)
        ],
        "unknown": [e.as_json() for e in strange],
        "places": {at: sorted(drive_train(model, at)) for at in sorted(names)},
        "visibility": {e.id: round(bench.found.get(e.id, 0.0), 1) for e in effects},
        "concealed": ways,
        "sensors": machine.sensors.as_json(),
    }
