"""What an actuator makes of its command: its force under a law, and logs of it.

Told from measured forces alone: no motion is simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.step import Fields, Step
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import clipped, is_joint_transmission
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import is_servo, stroke

Array = np.ndarray
BLOCK_S = 0.25
NEAR = 1e-6
"""Length and speed by which a law is probed for its slopes."""
PAUSE = 2.0
"""Seconds that a gap in a log counts for at most."""


class _Table(Fields):
    """Actuator fields of a model as plain arrays [1, ...] that hooks may change."""

    xp = np

    def __init__(self, model: mujoco.MjModel) -> None:
        names = (
            "actuator_gainprm", "actuator_biasprm", "actuator_gaintype", "actuator_biastype",
            "actuator_forcerange", "actuator_forcelimited",
        )  # fmt: skip
        self.values = {n: np.array(getattr(model, n), dtype=float)[None] for n in names}

    def get(self, name: str, index: Any) -> Array:
        return self.values[name][(slice(None), *index)]

    def set(self, name: str, index: Any, value: Any) -> None:
        self.values[name][(slice(None), *index)] = value


@dataclass(frozen=True)
class Log:
    """One recording of one actuator on a uniform grid.

    Attributes:
        name: of the recording. time: [T] s. u: [1, L] command on the grid. at: [T] grid index of each sample. force,
        length, speed: [T]. block: [T].
    """

    name: str
    time: Array
    u: Array
    at: Array
    force: Array
    length: Array
    speed: Array
    block: Array


def log_of(
    source: Source, ctx: Context, actuator: int, dt: float, first_block: int, first_row: int = 0
) -> Log | None:
    """One actuator's log, from a row on; those before only say how what follows began."""
    r, m = source.recording, ctx.model
    good = np.isfinite(r.known("force")[:, actuator])
    good[:first_row] = False
    if good.sum() < 20:
        return None
    # a pause in the log, over which the command stays, need not last longer than anything in a drive does
    t = np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(r.time), PAUSE))])
    grid = dt * np.arange(int(np.ceil(t[-1] / dt)) + 2)
    u = clipped(m, r.known("ctrl"))[
        np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, t.size - 1), actuator
    ]
    length, speed = stroke(m, actuator, source.states.qpos, source.states.qvel)
    # the first point of the grid that sees the row's own command
    at = np.clip(np.ceil(t / dt - 1e-6).astype(int), 0, grid.size - 1)
    block = first_block + (t / BLOCK_S).astype(int)
    force = r.known("force")[good, actuator]
    return Log(
        r.name, (r.origin + r.time)[good], u[None], at[good], force, length[good], speed[good], block[good]
    )


def between(
    model: mujoco.MjModel, ctx: Context, f: Fitted, actuator: int, source: Source
) -> tuple[Array, Array]:
    """`between_rows.Law` of one actuator under the law `f`: by how much its force jumps at each row as its command
    does [T] (without delays), and its slopes [T, 2]."""
    r = source.recording
    sent = clipped(model, r.known("ctrl"))[:, actuator]
    length, speed = stroke(model, actuator, source.states.qpos, source.states.qvel)
    rows = np.arange(r.time.size)

    def force(u: Array, further: float = 0.0, faster: float = 0.0) -> Array:
        log = Log(r.name, r.time, u[None], rows, np.zeros(rows.size), length + further, speed + faster, rows)
        return predict(model, ctx, f, actuator, log, ctx.period)

    now = force(sent)
    jump = now - force(np.concatenate([sent[:1], sent[:-1]]))
    slopes = np.stack([force(sent, further=NEAR) - now, force(sent, faster=NEAR) - now], 1) / NEAR
    known = np.isfinite(r.known("force")[:, actuator])
    return np.where(known, jump, 0.0), np.where(known[:, None], slopes, 0.0)


def predict(model: mujoco.MjModel, ctx: Context, f: Fitted, actuator: int, log: Log, dt: float) -> Array:
    """Force [T] of an actuator under its command and motion; `model` is the nominal one."""
    ctx = replace(ctx, model=model)
    table = _Table(model)
    parts = [(t, th[None]) for t, th in f.hypothesis.split(ctx, f.theta).items()]
    u = log.u
    for term, theta in parts:
        if term.effect.commands:
            u = term.effect.sampled(ctx, term.place, theta, u, dt)
        term.effect.model(table, ctx, term.place, theta)
    command = u[0][log.at]
    # an effect may add to what was clipped already
    if model.actuator_ctrllimited[actuator]:
        command = np.clip(command, *model.actuator_ctrlrange[actuator])
    gain = table.values["actuator_gainprm"][0, actuator]
    affine = table.values["actuator_biastype"][0, actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias = table.values["actuator_biasprm"][0, actuator] * affine
    free = gain[0] * command + bias[0] + bias[1] * log.length + bias[2] * log.speed
    low, high = table.values["actuator_forcerange"][0, actuator]
    if not table.values["actuator_forcelimited"][0, actuator]:
        low, high = -1e12, 1e12
    out = np.clip(free, low, high)

    def wide(value: Any) -> Array:
        column = np.zeros((out.size, model.nu))
        column[:, actuator] = value
        return column

    for term, theta in parts:
        if term.effect.runtime:
            s = Step(
                np.zeros((out.size, model.nq)), np.zeros((out.size, model.nv)), wide(command), wide(out),
                wide(free), wide(low), wide(high), wide(bias[1]), wide(bias[2]), lambda _b: np.zeros(3), dt,
            )  # fmt: skip
            forces, _ = term.effect.force(np, ctx, term.place, theta, s, ())
            if forces.actuator is not None:
                # as in simulation, what drives of no joint lose is taken from their command
                out = out if is_joint_transmission(model, actuator) else free
                out = out + forces.actuator
    return out


@dataclass
class Data:
    """Logs to fit a law to and to choose it by; deviation of the noise in their forces; step (s) of their grid; what
    the motion that the nominal law acts on leaves open of its forces (rms)."""

    train: list[Log]
    held: list[Log]
    sigma: float
    dt: float
    unsure: float = 0.0


def left_open(model: mujoco.MjModel, actuator: int, sources: Sequence[Source]) -> float:
    """By how much (rms) the force of an actuator's nominal law is unknown as the motion is: 0 of a plain motor."""
    if not is_servo(model, actuator):
        return 0.0
    dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
    slopes = model.actuator_gear[actuator, 0] * model.actuator_biasprm[actuator, 1:3]
    cov = np.concatenate([s.states.cov[:, dof] for s in sources])
    return float(np.sqrt(np.mean(slopes @ cov @ slopes)))


def residual(model: mujoco.MjModel, ctx: Context, f: Fitted, a: int, logs: list[Log], d: Data) -> Array:
    return np.concatenate([log.force - predict(model, ctx, f, a, log, d.dt) for log in logs]) / d.sigma


def blocks_of(r: Array, logs: list[Log]) -> Array:
    """Mean squared residual of each block [B]."""
    block = np.concatenate([log.block for log in logs])
    _, index = np.unique(block, return_inverse=True)
    return np.bincount(index, r**2) / np.bincount(index)
