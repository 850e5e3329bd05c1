"""Drawing one case: hidden physics whose size is visible over the noise but not trivially large."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from experiments.blind.draws import Place, draw
from experiments.blind.equivalence import drive_train, twins_of
from experiments.blind.machine import Machine
from experiments.blind.plant import Unstable
from experiments.blind.separability import distinct_share
from experiments.blind.simulate import Trajectory
from experiments.blind.statistics import Statistics
from experiments.blind.vocabulary import Effect
from experiments.blind.windows import rms, window_errors

WEAKEST, STRONGEST = 12.0, 250.0  # window error over what noise and time step explain, at the worst joint
DISTINCT = 4.0  # the part of it that no simpler effect can imitate
LEAST = 3e-4  # rad: with very good sensors a floor all the same, so that effects have a physical size
RANGE = 0.6  # window error over the spread of the motion, at most
TRIALS = 7


class Unfit(RuntimeError):
    """No visible size was found here; draw another place or machine."""


@dataclass
class Bench:
    """A machine, its nominal runs on the checking recordings, and the errors that noise and time step explain."""

    machine: Machine
    runs: list[Trajectory]
    floor: np.ndarray
    spread: np.ndarray
    stats: Statistics
    found: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, machine: Machine) -> "Bench":
        """Runs the nominal machine; raises Unfit where it does not move as it should."""
        model = machine.model
        try:
            runs = [machine.record(plan) for plan in machine.checking]
        except Unstable as reason:
            raise Unfit(str(reason)) from None
        mismatch = rms(np.concatenate([window_errors(model, run) for run in runs]))
        spread = np.max([run.qvel.std(0) for run in runs], 0) * 0.3
        driven = np.median([run.qvel[len(run.qvel) // 2 :].std(0) for run in runs], 0)
        if (driven < 0.02).any() or not (mismatch < 0.1).all():
            raise Unfit("the nominal machine stands still, or its windows are chaotic")
        floor = np.hypot(machine.sensors.floor(model), mismatch)
        floor = np.maximum(floor, LEAST * machine.sensors.scale(model))
        return cls(machine, runs, floor, spread, Statistics(model, runs))

    def visibility(self, effects: list[Effect]) -> tuple[float, float, list[Trajectory]]:
        """(error over the floor, error over the motion's spread) of the nominal model's windows, and the runs."""
        runs = [self.machine.record(plan, effects) for plan in self.machine.checking]
        errors = rms(np.concatenate([window_errors(self.machine.model, run) for run in runs]))
        return float((errors / self.floor).max()), float((errors / (self.spread + 1e-6)).max()), runs


def place(bench: Bench, at: str, rng: np.random.Generator) -> Place:
    """A place on the bench's machine; actuators go by name or, nameless, by their joint."""
    model, machine = bench.machine.model, bench.machine
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, at)
    if index < 0:
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, at)
        on = (
            np.flatnonzero((model.actuator_trnid[:, 0] == joint) & (model.actuator_trntype == 0))
            if joint >= 0
            else []
        )
        index = int(on[0]) if len(on) else -1
    return Place(machine.robot, bench.stats, at, index, machine.dt, int(rng.integers(2**31)))


def draw_visible(
    bench: Bench, effect: str, at: str, rng: np.random.Generator, unknown: bool = False
) -> Effect:
    """An effect whose window error is a random number of floors; raises Unfit after a few trials."""
    where, wish = place(bench, at, rng), float(np.exp(rng.uniform(np.log(20), np.log(110))))
    size = 1.0
    for _ in range(TRIALS):
        candidate = draw(effect, where, size, unknown)
        try:
            seen, share, runs = bench.visibility([candidate])
        except Unstable:
            size *= 0.4
            continue
        distinct = seen * distinct_share(candidate, bench.machine.model, runs)
        strong = seen <= STRONGEST and share <= RANGE
        if effect == "dead_actuator" and seen >= WEAKEST:
            return candidate
        if distinct < DISTINCT or seen < WEAKEST:
            if share > RANGE:
                break
            factor = max(WEAKEST / seen, DISTINCT / max(distinct, 1e-3), 1.15) ** 0.8 * 1.1
        elif not strong:
            factor = max(min(STRONGEST / seen, RANGE / share) ** 0.8 * 0.9, 0.2)
        elif 0.5 * wish < seen < 2 * wish or share > 0.6 * RANGE:
            bench.found[effect] = seen
            return candidate
        else:
            factor = (wish / seen) ** 0.8
        new = size * min(max(factor, 0.15), 4.0)
        if draw(effect, where, new, unknown) == candidate:
            break
        size = new
    else:
        candidate = draw(effect, where, size, unknown)
        try:
            seen, share, runs = bench.visibility([candidate])
        except Unstable as reason:
            raise Unfit(str(reason)) from None
        distinct = seen * distinct_share(candidate, bench.machine.model, runs)
    if WEAKEST <= seen <= STRONGEST and share <= RANGE and distinct >= DISTINCT:
        bench.found[effect] = seen
        return candidate
    raise Unfit(f"{effect} at {at} is not visible at a sensible size on {bench.machine.robot.name}")


def answer(bench: Bench, kind: str, effects: list[Effect]) -> dict:
    """What the scorer has to know about a case (the engine never sees it)."""
    machine, model = bench.machine, bench.machine.model
    known = [e for e in effects if not e.unknown]
    strange = [e for e in effects if e.unknown]
    names = {at for e in effects for at in (e.at,)}
    twins = [twins_of(machine.robot, model, e, machine.sensors.force_noise is not None) for e in known]
    ways = machine.sensors.ways() + [f"true step {machine.dt} s, {machine.integrator}"]
    ways += ["open loop" if machine.open_loop else "closed loop"]
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
