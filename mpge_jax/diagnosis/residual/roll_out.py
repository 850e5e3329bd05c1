"""Whether a machine with a fitted force stays where machines stay, under commands that nobody recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
SECONDS, ROW, HOLD = 60.0, 0.02, 0.3
"""Length of a roll-out, time between its rows, and how long a random command is held (s)."""
AWAY = 10.0
"""Times the greatest speed that was recorded, or is reached without the force, beyond which a joint is gone."""


def staying(p: Prepared, fits: list[Fitted]) -> int:
    """How many forces may act, one more in each fit than in the one before (none in the first), so that a minute of
    random commands, of those that were recorded, ends where it does without the last of them: no joint moves ten times
    as fast as it ever did. The model's own steps are asked where it does not in larger ones."""
    seen, count = np.array([np.abs(s.states.qvel).max(0) for s in p.train]).max(0), 0
    for cheaply in (True, False) if p.sim.stride > 1 else (False,):
        speeds = greatest_speeds(p, fits, cheaply)
        usual = np.maximum(seen, np.nan_to_num(speeds[:-1], posinf=0.0))
        stays = (speeds[1:] <= AWAY * np.maximum(usual, 1e-6)).all(1)
        count = int(np.logical_and.accumulate(stays).sum())
        if count == len(fits) - 1:
            break
    return count


def greatest_speeds(p: Prepared, fits: list[Fitted], cheaply: bool = False) -> Array:
    """[F, nv] of roll-outs under the same commands, in larger steps or the model's own; infinite where the simulation
    breaks down."""
    m, rng = p.model, np.random.default_rng([p.config.seed, 41])
    time = np.arange(0.0, SECONDS + ROW / 2, ROW)
    recorded = np.concatenate([s.command for s in p.train])
    changes = rng.integers(len(recorded), size=int(SECONDS / HOLD) + 1)
    command = recorded[changes[(time / HOLD).astype(int)]]
    start = p.train[0].states
    qpos, still = np.tile(start.qpos[0], (time.size, 1)), np.zeros((time.size, m.nv))
    states = States(qpos, still, still, np.zeros((time.size, m.nv, 2, 2)))
    source = Source.build(Recording("roll-out", time, qpos, still, command), states, command)
    # speeds at rest, as if measured: what is missed is the machine's own
    noise = replace(p.noise, qvel=np.ones(m.nv))
    w = cut((source,), m, noise, SECONDS, 1, p.dt, rng, max_samples=time.size)
    if not w.count:
        return np.zeros((len(fits), m.nv))
    runs = [Run(f.hypothesis, f.theta) for f in fits]
    simulate = p.sim.cheaply if cheaply else p.sim.residuals
    speed = np.abs(simulate(runs, w)[:, 0, :, m.nv :])
    return np.where(np.isfinite(speed), speed, np.inf).max(1)
