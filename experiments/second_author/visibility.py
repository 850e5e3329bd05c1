"""How far hidden physics stands out of what noise and the time step explain, in windows from true states."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from experiments.second_author.excitation import Array
from experiments.second_author.recording import Case, Recorded, Sensors
from experiments.second_author.simulation import Effect, Sim

WINDOW = 0.5  # s


@dataclass(frozen=True)
class Start:
    """How a machine that lacks one of the true effects is put into the true machine's states.

    index: of its effects among the true ones. own: whether it begins with the true machine's own coordinates, where it
    has as many; these are not what is read where the effect that it lacks was in a sensor.
    """

    index: tuple[int, ...]
    own: bool


def window_errors(
    case: Case, run: Recorded, effects: Sequence[Effect], dt: float | None = None, start: Start | None = None
) -> Array:
    """Recorded positions without their noise less predicted ones [rows, nv], in windows one after another.

    Args:
        effects: of the machine that predicts. dt: its time step [s]; that of the nominal model where none is given.
        start: none: windows start from what sensors read without noise.
    """
    sim = Sim(case.xml, effects, dt)
    m, out = sim.nominal, []
    step = sim.dt
    rows = _rows(run)
    for first in range(0, len(run.time) - rows, rows):
        sim.reset(run.qpos[first], run.qvel[first])
        if start is not None:
            moment = run.moments[first]
            if start.own and len(moment.qpos) == sim.m.nq:
                sim.d.qpos[:], sim.d.qvel[:] = moment.qpos, moment.qvel
            for e, i in zip(sim.effects, start.index, strict=True):
                state = moment.states[i]
                e.state = state.copy() if hasattr(state, "copy") else state
            mujoco.mj_forward(sim.m, sim.d)
        for row in range(first, first + rows):
            sim.hold(run.ctrl[row], float(run.time[row + 1] - run.time[row]), step)
            error = np.zeros(m.nv)
            mujoco.mj_differentiatePos(m, error, 1.0, sim.measured()[0], run.qpos[row + 1])
            out.append(error)
    return np.array(out)


def step_errors(case: Case, run: Recorded) -> Array:
    """What the finer steps of the true machine change by themselves [rows, nv], in every other window."""
    sims = [(sim, sim.dt) for sim in (Sim(case.xml), Sim(case.xml, (), case.dt))]
    m, out = sims[0][0].nominal, []
    rows = _rows(run)
    for first in range(0, len(run.time) - rows, 2 * rows):
        for sim, _ in sims:
            sim.reset(run.qpos[first], run.qvel[first])
        for row in range(first, first + rows):
            span = float(run.time[row + 1] - run.time[row])
            for sim, step in sims:
                sim.hold(run.ctrl[row], span, step)
            error = np.zeros(m.nv)
            mujoco.mj_differentiatePos(m, error, 1.0, sims[0][0].link()[0], sims[1][0].link()[0])
            out.append(error)
    return np.array(out)


def visibility(case: Case, runs: Sequence[Recorded]) -> dict[str, float]:
    """By the effects' names: errors of the machine that lacks this one alone, over what noise and time step explain,
    at the worst degree of freedom; of effects that several joints have, the least.

    The machine that lacks all of them is the nominal one: it predicts with its own time step.
    """
    effects = case.effects()
    sensors = Sensors(case, mujoco.MjModel.from_xml_string(case.xml))
    floor = (
        np.hypot(sensors.sigma, _rms([step_errors(case, run) for run in runs])) if effects else sensors.sigma
    )
    seen: dict[str, float] = {}
    for i, lacking in enumerate(effects):
        if len(effects) == 1:
            errors = [window_errors(case, run, []) for run in runs]
        else:
            kept = tuple(j for j in range(len(effects)) if j != i)
            own = any(effects[j].parted for j in kept) or not lacking.in_sensor
            start = Start(kept, own)
            errors = []
            for run in runs:
                anew = case.effects()
                rest = [anew[j] for j in kept]
                errors.append(window_errors(case, run, rest, case.dt, start))
        value = float(np.max(_rms(errors) / floor))
        seen[lacking.id] = round(min(value, seen.get(lacking.id, np.inf)), 1)
    return seen


def _rows(run: Recorded) -> int:
    """Rows of a window."""
    return round(WINDOW / float(np.median(np.diff(run.time))))


def _rms(errors: Sequence[Array]) -> Array:
    """Root mean square [nv] over the rows of all."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
