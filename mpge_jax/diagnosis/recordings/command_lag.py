"""How long after their stamps commands act, where these are on another clock than the motion: a lag that all actuators
have in common is clock or delay, which no log can tell apart; what one has beside the others is its own."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_joint_transmission

Array = np.ndarray
LONGEST = 0.25
"""Seconds up to which a lag is looked for, either way."""
OVER = 0.01
"""Seconds on either side of a row, at least, over which its acceleration is taken."""
ENOUGH, ROWS = 60, 4000
"""Rows that are needed, and rows that are used at most."""
EXPLAINED = 0.2
"""Least share of a command that the force must explain beside position, velocity and friction."""
LEAST, ALMOST_NONE, TINY = 1e-9, 1e-9, 1e-18
"""Share of a command that counts as nothing left; size of a direction, and of a square, that counts as none."""
SHARP = 20.0
"""Least fall of twice the log likelihood towards the best lag, from a row beside it."""
ALIKE = 1.0
"""Rows within which lags of several actuators are one."""
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


@dataclass(frozen=True)
class Driven:
    """Some rows of a log, and what explains commands there.

    Attributes:
        time: [T] s of the log. rows: [R] rows, each taken with `s` on either side. step: s from row to row.
        motion: actuator to an orthonormal basis [R, m] of position, velocity, friction and a constant. force: the same
            with the joint's force beside, and with accelerations, where it is by the model.
    """

    time: Array
    rows: Array
    s: int
    step: float
    motion: dict[int, Array]
    force: dict[int, Array]

    @property
    def independent(self) -> float:
        """How many rows share none of theirs."""
        return self.rows.size / (2 * self.s)

    def mean(self, command: Array, lag: float = 0.0) -> Array:
        """[R] of a command [T] around the rows, `lag` s late."""
        return _mean(self.time, _integral(self.time, command), self.rows, self.s, lag)

    def left(self, a: int, x: Array) -> Array:
        """[R] of an actuator's command that motion and force do not explain."""
        return _apart(self.force[a], x)

    def share_left(self, a: int, x: Array) -> float:
        """Share that this is of what motion alone does not explain."""
        alone = float(np.sum(_apart(self.motion[a], x) ** 2))
        return float(np.sum(self.left(a, x) ** 2)) / alone if alone > TINY * float(x @ x) else 1.0


def _apart(basis: Array, x: Array) -> Array:
    return x - basis @ (basis.T @ x)


def what_drives(
    time: Array,
    qpos: Array,
    qvel: Array | None,
    ctrl: Array,
    model: mujoco.MjModel,
    measured: Array | None = None,
) -> Driven | None:
    """The forces of driven joints, measured or else by inverse dynamics of the model; None where these do not tell.

    Accelerations are differences over some rows, and commands are averaged over the same time, so that neither is
    late.

    Args:
        time: [T] s. qpos: [T, nq]. qvel: [T, nv] or None. ctrl: [T, nu]. measured: [T, nu] forces of actuators, or
            None.
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
    needed = _needed(model, qpos[rows], v, acceleration) if measured is None else np.empty((rows.size, 0))
    motion, force = {}, {}
    for a, joint in joint_of.items():
        column, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        q, speed = qpos[rows, column], v[:, column if qvel is None else dof]
        friction = np.tanh(speed / max(0.1 * float(np.std(speed)), 1e-9))
        moves = [q, speed, friction, np.ones_like(q)]
        if measured is not None:
            felt = [_mean(time, _integral(time, measured[:, a]), rows, s, 0.0)]
        else:
            # inertia that the model lacks would pass for another lag of smooth commands
            felt = [needed[:, dof], *acceleration.T]
        motion[a], force[a] = _basis(moves), _basis(moves + felt)
    return Driven(time, rows, s, step, motion, force)


def _basis(columns: list[Array]) -> Array:
    """An orthonormal basis [R, m] of some columns [R], as many as differ."""
    x = np.stack([c / max(float(np.linalg.norm(c)), 1e-300) for c in columns], axis=1)
    u, size, _ = np.linalg.svd(x, full_matrices=False)
    return u[:, size > ALMOST_NONE * size[0]]


def common_lag(driven: Driven | None, ctrl: Array) -> Lag | None:
    """The lag at which forces explain the commands [T, nu] best: these are regressed on force, position, velocity,
    friction and a constant, and on accelerations where the force is by the model, for every lag. None where they do not
    tell."""
    if driven is None:
        return None
    step = driven.step
    lags = np.arange(-LONGEST, LONGEST + 1e-9, max(step / 4, 1e-3))
    curves = {}
    for a in driven.force:
        curve = _misfit(driven, a, ctrl[:, a], lags)
        if curve is not None and _is_sharp(curve, lags, step, driven.independent):
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


def _misfit(driven: Driven, a: int, command: Array, lags: Array) -> Array | None:
    """Logarithm of the share of a command that is left at each lag; None where the force explains too little of it."""
    total = _integral(driven.time, command)
    means = (_mean(driven.time, total, driven.rows, driven.s, lag) for lag in lags)
    left = np.array([driven.share_left(a, x) for x in means])
    return None if left.min() > 1 - EXPLAINED else np.log(np.maximum(left, LEAST))


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
