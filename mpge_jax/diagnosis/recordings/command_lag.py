"""How long after their stamps commands act, where these are on another clock than the motion: a lag that all actuators
have in common is clock or delay, which no log can tell apart; what one has beside the others is its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
LONGEST = 0.25
"""Seconds up to which a lag is looked for, either way."""
OVER = 0.01
"""Seconds on either side of a row, at least, over which its acceleration is taken."""
ENOUGH, ROWS = 60, 4000
"""Rows that are needed, and rows that are used at most."""
FEWEST_ROWS = 2
"""Rows of the shortest log."""
EXPLAINED = 0.2
"""Least share of the force that a command must explain beside position, velocity and friction."""
SHARP = 20.0
"""Least fall of twice the log likelihood towards the best lag, from a row beside it."""
ALIKE = 1.0
"""Rows within which lags of several actuators are one."""
READ_SO = (
    "each row of the log holds the command that was sent a row before (motion or measured force runs a row ahead of "
    "the commands): commands were moved one row back."
)
NOT_TOLD = (
    "how late commands act all together cannot be told from it: a delay that all actuators have in common may be the "
    "clock's."
)


@dataclass(frozen=True)
class Lag:
    """common: s after their stamps that all commands act. each: actuator to its own lag. step: s from row to row."""

    common: float
    each: dict[int, float]
    step: float

    @property
    def within(self) -> float:
        """s to within which it is known: rows show no less."""
        return 0.5 * self.step

    @property
    def matters(self) -> bool:
        """Whether it is as large as rows can show."""
        return abs(self.common) > self.within

    def told(self, actuators: tuple[str, ...]) -> str:
        """A sentence or two for the user."""
        if not self.matters:
            what = "commands act at their stamps, to within half a row"
        else:
            when = "after" if self.common > 0 else "before"
            what = f"commands act {1e3 * abs(self.common):.3g} ms {when} their stamps, to within half a row"
        if len(self.each) > 1 and np.ptp(list(self.each.values())) > ALIKE * self.step:
            own = ", ".join(f"{actuators[a]} {1e3 * x:.3g} ms" for a, x in self.each.items())
            what += f", and not alike ({own})"
        if not self.matters:
            return f"{what}."
        return f"{what}. What all have in common is clock or delay: it was taken off, and is no actuator's effect."


def without_previous_commands(
    recordings: list[Recording], model: mujoco.MjModel
) -> tuple[list[Recording], list[str]]:
    """The same with every command on the row at which it was given, where each row holds that of the row before: the
    motion then follows commands before they were sent, which no delay and no clock of a machine explains. And what was
    done, for the user."""
    told = 0
    # where some have none, commands drive the machine in all
    measured = all(r.force is not None for r in recordings)
    for r in recordings:
        force = r.force if measured else None
        lag = None if r.ctrl is None else common_lag(r.time, r.qpos, r.qvel, r.ctrl, model, force)
        if lag is not None and not -1.5 < lag.common / lag.step < -0.5:
            return recordings, []
        told += lag is not None
    if 2 * told <= len(recordings):
        return recordings, []
    return [_read_so(r) for r in recordings], [READ_SO]


def _read_so(r: Recording) -> Recording:
    """Every row with the command of the next one. The last one goes, as its command was not logged, but from a log of
    two rows, of which it tells where the first command led."""
    moved = a_row_earlier(r, slice(None))
    if r.ctrl is None or r.time.size <= FEWEST_ROWS:
        return moved
    keys = ("time", "qpos", "qvel", "ctrl", "force")
    return replace(moved, **{k: v[:-1] for k in keys if (v := getattr(moved, k)) is not None})


def a_row_earlier(r: Recording, actuators: slice | Array) -> Recording:
    """The same with the commands of some actuators a row earlier, the last one repeated."""
    if r.ctrl is None:
        return r
    ctrl = r.ctrl.copy()
    ctrl[:-1, actuators] = r.ctrl[1:, actuators]
    before = None if r.earlier is None else a_row_earlier(r.earlier, actuators)
    return replace(r, ctrl=ctrl, earlier=before)


def common_lag(
    time: Array,
    qpos: Array,
    qvel: Array | None,
    ctrl: Array,
    model: mujoco.MjModel,
    measured: Array | None = None,
) -> Lag | None:
    """The lag with which commands [T, nu] explain the forces of the actuators, or those that the motion needs; None
    where they do not tell.

    The force of each driven joint, measured or else by inverse dynamics of the model, is regressed on its command,
    position, velocity, friction and a constant, for every lag. Accelerations are differences over some rows, and
    commands are averaged over the same time, so that neither is late.

    Args:
        time: [T] s. qpos: [T, nq]. qvel: [T, nv] or None. measured: [T, nu] forces of actuators, or None.
    """
    driven = [a for a in range(model.nu) if is_joint_transmission(model, a)]
    known = [] if measured is None else [a for a in driven if np.isfinite(measured[:, a]).all()]
    measured, driven = (measured, known) if known else (None, driven)
    joint_of = {a: int(model.actuator_trnid[a, 0]) for a in driven}
    needs = qpos if measured is None else qpos[:, model.jnt_qposadr[list(joint_of.values())]]
    if (model.nq != model.nv and measured is None) or not driven or time.size < ENOUGH:
        return None
    step = float(np.median(np.diff(time)))
    s = max(1, round(OVER / step))
    rows = _rows(time, s, step)
    if rows.size < ENOUGH or not np.isfinite(ctrl).all() or np.isnan(needs).any():
        return None
    qvel = None if qvel is None or np.isnan(qvel).any() else qvel
    v, acceleration = _motion(time, qpos, qvel, rows, s)
    lags = np.arange(-LONGEST, LONGEST + 1e-9, max(step / 4, 1e-3))
    if measured is None:
        needed = _needed(model, qpos[rows], v, acceleration)
        forces = {a: needed[:, model.jnt_dofadr[joint]] for a, joint in joint_of.items()}
    else:
        forces = {a: _mean(time, _integral(time, measured[:, a]), rows, s, 0.0) for a in driven}
    curves = {}
    for a, joint in joint_of.items():
        column = int(model.jnt_qposadr[joint])
        speed = v[:, column if qvel is None else model.jnt_dofadr[joint]]
        curve = _misfit(time, ctrl[:, a], forces[a], qpos[rows, column], speed, rows, s, lags)
        if curve is not None and _is_sharp(curve, lags, step, rows.size / (2 * s)):
            curves[a] = curve
    if not curves:
        return None
    each = {a: _least(lags, curve) for a, curve in curves.items()}
    alike = np.ptp(list(each.values())) <= ALIKE * step
    # no machine acts before it is told: where one is ahead of its stamps, it is the clock that is late, for all
    common = _least(lags, np.sum(list(curves.values()), axis=0)) if alike else min(each.values())
    return Lag(common, each, step)


def _rows(time: Array, s: int, step: float) -> Array:
    """Rows in the middle of whole stretches, far enough from both ends."""
    rows = np.arange(2 * s, time.size - 2 * s)
    whole = time[rows + 2 * s] - time[rows - 2 * s] < 1.5 * 4 * s * step
    inside = (time[rows] > time[0] + LONGEST + 2 * s * step) & (
        time[rows] < time[-1] - LONGEST - 2 * s * step
    )
    rows = rows[whole & inside]
    return rows[:: max(1, -(-rows.size // ROWS))]


def _motion(time: Array, qpos: Array, qvel: Array | None, rows: Array, s: int) -> tuple[Array, Array]:
    """Velocities and accelerations [R, nv] at some rows by differences over `s` rows on either side."""

    def slope(x: Array, at: Array) -> Array:
        return (x[at + s] - x[at - s]) / (time[at + s] - time[at - s])[:, None]

    if qvel is not None:
        return qvel[rows], slope(qvel, rows)
    before, after = slope(qpos, rows - s), slope(qpos, rows + s)
    return slope(qpos, rows), (after - before) / (time[rows + s] - time[rows - s])[:, None]


def _needed(model: mujoco.MjModel, qpos: Array, qvel: Array, acceleration: Array) -> Array:
    """Forces [R, nv] that a motion needs."""
    data, out = mujoco.MjData(model), np.empty_like(qvel)
    for k in range(len(qpos)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[k], qvel[k], acceleration[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def _misfit(
    time: Array, command: Array, force: Array, q: Array, v: Array, rows: Array, s: int, lags: Array
) -> Array | None:
    """Logarithm of the variance of the force that is left at each lag; None where the command explains too little."""
    fixed = np.stack([q, v, np.tanh(v / max(0.1 * float(np.std(v)), 1e-9)), np.ones_like(q)], axis=1)
    basis, _ = np.linalg.qr(fixed)
    y = force - basis @ (basis.T @ force)
    whole = float(y @ y)
    if whole <= 1e-18 * max(float(force @ force), 1e-300):
        return None
    left, total = np.empty(lags.size), _integral(time, command)
    for i, lag in enumerate(lags):
        x = _mean(time, total, rows, s, lag)
        x = x - basis @ (basis.T @ x)
        size = float(x @ x)
        left[i] = whole - (float(x @ y) ** 2 / size if size > 0 else 0.0)
    left = np.maximum(left, 1e-9 * whole)
    return None if left.min() > (1 - EXPLAINED) * whole else np.log(left)


def _integral(time: Array, held: Array) -> Array:
    """Running integral [T] of what is held from row to row."""
    return np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(time))])


def _mean(time: Array, total: Array, rows: Array, s: int, lag: float) -> Array:
    """Mean [R] over the time around some rows, `lag` s late, of what has the running integral `total` [T]."""
    first, last = time[rows - s], time[rows + s]
    return (np.interp(last - lag, time, total) - np.interp(first - lag, time, total)) / (last - first)


def _is_sharp(curve: Array, lags: Array, step: float, independent: float) -> bool:
    """Whether the least is not at an end, and a row beside it is clearly worse."""
    i, beside = int(curve.argmin()), max(1, round(step / (lags[1] - lags[0])))
    if i < beside or i >= lags.size - beside:
        return False
    return bool(independent * (min(curve[i - beside], curve[i + beside]) - curve[i]) > SHARP)


def _least(lags: Array, curve: Array) -> float:
    """Where a curve is least, between the lags by a parabola."""
    i = int(np.clip(curve.argmin(), 1, lags.size - 2))
    a, b, c = curve[i - 1 : i + 2]
    bend = a - 2 * b + c
    return float(lags[i] + (0.5 * (a - c) / bend if bend > 0 else 0.0) * (lags[1] - lags[0]))
