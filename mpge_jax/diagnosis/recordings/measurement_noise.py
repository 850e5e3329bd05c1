"""Measurement noise of every column of the recordings: positions, velocities and time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.joint_space import dof_of_column
from mpge_jax.diagnosis.machine.model import Names, is_scalar
from mpge_jax.diagnosis.recordings import recorded_velocities
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.rows.clock_noise import stamp_deviation

Array = np.ndarray
SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR = 1e-6, 1e-5
INEXACT_STAMPS = (
    "the time stamps are inexact by about {:.2g} ms: the noise of positions grows with the speed, alike at all joints; "
    "this is taken into account."
)


@dataclass(frozen=True)
class Noise:
    """Deviations of the measurement noise per column, quantisation included.

    Attributes:
        qpos: [nq]. qvel: [nv]; infinite where recorded velocities are not used. quantum: [nq].
        direct: whether the measurements are taken as states without smoothing (see `coarse_sampling`).
        stamp: deviation (s) of the time stamps: a position is off by as much times its speed, too.
    """

    qpos: Array
    qvel: Array
    quantum: Array
    direct: bool = False
    stamp: float = 0.0

    def angle(self, column: int) -> float:
        """Deviation (rad, per axis) of an orientation whose quaternion begins at a column of qpos.

        A rotation by r moves the quaternion by |r| / 2 within the three directions that keep its length; how they
        share it depends on the pose (near the identity the first component hardly moves).
        """
        return 2.0 * float(np.sqrt((self.qpos[column : column + 4] ** 2).sum() / 3.0))


def noise_of(
    recordings: list[Recording], model: mujoco.MjModel, names: Names, recorded: list[Recording] | None = None
) -> tuple[Noise, list[str]]:
    """Noise levels, and warnings.

    Args:
        recorded: the recordings before any reading was corrected, if that happened.
    """
    warnings: list[str] = []
    qpos_noise, quanta = np.full(model.nq, np.nan), np.zeros(model.nq)
    times, dofs = [r.time for r in recordings], dof_of_column(model)
    stamp = stamp_deviation(times, [[r.qpos[:, c] for r in recordings] for c in dofs])
    for c in range(model.nq):
        qpos_noise[c], quanta[c] = column_noise(
            times, [r.qpos[:, c] for r in recordings], rests=True, stamp=stamp if c in dofs else 0.0
        )
    if stamp:
        warnings.append(INEXACT_STAMPS.format(1e3 * stamp))
    _as_others(recordings, model, qpos_noise, quanta)
    qvel_noise = np.full(model.nv, np.inf)
    with_velocity = [(r.time, r.qvel) for r in recordings if r.qvel is not None]
    for d in range(model.nv):
        level, _ = column_noise([t for t, _ in with_velocity], [v[:, d] for _, v in with_velocity])
        if np.isfinite(level):
            qvel_noise[d] = level
        elif any(not np.isnan(v[:, d]).all() for _, v in with_velocity):
            qvel_noise[d] = SIGMA_VELOCITY_FLOOR
    qpos_noise = np.maximum(np.nan_to_num(qpos_noise, nan=SIGMA_FLOOR), SIGMA_FLOOR)
    qvel_noise = np.maximum(qvel_noise, SIGMA_VELOCITY_FLOOR)
    derived = recorded_velocities.derived(recorded or recordings, dofs, qvel_noise)
    wrong = recorded_velocities.wrong(recordings, dofs, qpos_noise, qvel_noise)
    for unused, why in (
        (derived, "are the differences of the recorded positions: they say nothing more, and are not used."),
        (
            [d for d in wrong if d not in derived],
            "disagree with the positions (filtered, late or of another sign); velocities are taken from the positions.",
        ),
    ):
        if unused:
            joints = sorted({names.joint_of_dof(model, d) for d in unused})
            warnings.append(f"recorded velocities of {', '.join(joints)} {why}")
            qvel_noise[unused] = np.inf
    return Noise(qpos_noise, qvel_noise, quanta, stamp=stamp), warnings


def _as_others(recordings: list[Recording], model: mujoco.MjModel, noise: Array, quanta: Array) -> None:
    """Give joints whose reading never changed the noise of the finest quantised encoder of their kind, in place: within
    its steps they may have moved."""
    columns: dict[int, list[int]] = {}
    for j in range(model.njnt):
        if is_scalar(model, j):
            columns.setdefault(int(model.jnt_type[j]), []).append(int(model.jnt_qposadr[j]))
    for alike in columns.values():
        known = [quanta[c] for c in alike if quanta[c] > 0]
        for c in alike if known else []:
            if all(np.ptp(r.qpos[:, c]) == 0 for r in recordings):
                quanta[c] = min(known)
                noise[c] = max(np.nan_to_num(noise[c]), min(known) / np.sqrt(12))
