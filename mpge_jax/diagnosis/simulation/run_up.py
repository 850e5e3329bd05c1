"""What drives hide where windows start: the machine runs up to them along its recorded motion.

No encoder sees a motor inside the gap of its drive: only what it did before tells where it is. A link that was held to
the recorded motion would not give way where it is struck, and the motor would leave it at another speed. So the whole
machine is simulated up to the start, drawn to what was recorded as an observer draws it.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.machine.joint_space import difference, integrate
from mpge_jax.diagnosis.simulation.driving.actuator_state import settled
from mpge_jax.diagnosis.simulation.runtime_effects import Runtime, diverged, either
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
SECONDS = 0.4
"""Length of a run-up: a motor that strikes both ends of its gap has forgotten by then where it began."""
DRAWN = 0.03
"""Seconds in which the machine is drawn to its recorded motion: longer than a motor and a link take to strike each
other and part, shorter than what the model lacks takes to lead it astray."""
DRAWS = 10
"""Draws in that time."""


def run_up(
    batch: Batch,
    model: mujoco.MjModel,
    runtime: Runtime,
    w: Windows,
    window: Array,
    moved: Array,
    commanded: Callable[[int], Array],
) -> None:
    """Leave the memories of drives with gaps as they are where the windows start, and the batch there, at other speeds
    where the run-up knows them better. Where nothing was recorded before a window all stays as it is.

    Args:
        window, moved, commanded: as in `Runtime.begin`.
    """
    if not any(g.term.effect.rugged for g in runtime.groups):
        return
    longest = min(int(np.ceil(SECONDS / w.dt)), w.history)
    past_q, past_v, ago = (x[:, -longest:] for x in w.before(model))
    rows = (ago > w.dt * np.arange(longest, 0, -1) - 1e-9).sum(1)[window]
    if not rows.any():
        return
    qpos, qvel, guess = (batch.bind(k) for k in ("qpos", "qvel", "qacc_warmstart"))
    act = batch.bind("act") if model.na else np.zeros((rows.size, 0))
    q0, v0, act0 = qpos.copy(), qvel.copy(), act.copy()
    aside, every = difference(model, w.q0[window], q0), max(int(DRAWN / DRAWS / w.dt), 1)
    gain = 1.0 - np.exp(-every * w.dt / DRAWN)
    at_rest = [g.memory for g in runtime.groups]

    def recorded(k: int) -> tuple[Array, Array]:
        """The motion k steps before the starts, moved along with them."""
        if k == 0:
            return q0, v0
        offset = aside - moved * ago[window, -k, None]
        return integrate(model, past_q[window, -k], offset), past_v[window, -k] + moved

    for k in range(int(rows.max()), 0, -1):
        command, begins = commanded(-k), rows == k
        batch.bind("ctrl")[:] = command
        if begins.any():
            q, v = recorded(k)
            qpos[begins], qvel[begins], guess[begins] = q[begins], v[begins], 0.0
            act[begins] = settled(model, command, act0)[begins]
            runtime.recall(begins)
        runtime.apply()
        batch.step()
        lost = diverged(qvel)
        if (k - 1) % every and not lost.any():
            continue
        q, v = recorded(k - 1)
        qpos[lost], qvel[lost] = q[lost], v[lost]
        qpos[:] = integrate(model, qpos, gain * difference(model, qpos, q))
        qvel[:] += gain * (v - qvel)
    for g, static in zip(runtime.groups, at_rest, strict=True):
        if not g.term.effect.rugged:
            g.memory = static
            continue
        of, ctx, place = g.rows, runtime.ctx, g.term.place
        a, d = ctx.qadr(place), ctx.dof(place)
        reached, start = (qpos[of, a], qvel[of, d]), (q0[of, a], v0[of, d])
        memory, speed = g.term.effect.resumed(g.theta, g.memory, reached, start)
        followed = rows[of] > 0
        g.memory, v0[of, d] = either(followed, memory, static), np.where(followed, speed, start[1])
    qpos[:], qvel[:], act[:], guess[:] = q0, v0, act0, 0.0
    runtime.refresh()
