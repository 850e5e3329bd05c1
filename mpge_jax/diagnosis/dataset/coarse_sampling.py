"""Noise of logs whose samples lie too far apart for their differences to show it (transitions of a learner's task).

High-order differences take motion between two rows for noise: at 20 rows a second a running machine seems to be
measured to a tenth of a radian. Where velocities were recorded too, every pair of rows is a prediction of its own:
from the state as measured, over one interval. What the best hypothesis misses there holds the noise of both rows and
whatever physics is still missing, so it bounds the noise from above; the lower of the two bounds is taken.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.screening import screen
from mpge_jax.diagnosis.estimation.whitening import Whitener, column_scale
from mpge_jax.diagnosis.machine.joint_space import integrate
from mpge_jax.diagnosis.machine.model import qpos_columns
from mpge_jax.diagnosis.recordings.measurement_noise import SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR, Noise
from mpge_jax.diagnosis.recordings.noise_level import MAD
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
INTERVALS = 40
"""Pairs of rows that are predicted."""
INTERVALS_IN_THE_END = 300
"""And in the end, when the hypothesis is chosen."""
KEEP = 5
ROUNDS, LEAST = 8, 0.3
"""How often the noise of one row is estimated from what it leads to, and the least share of a miss that it is."""
DEPTH = 2
"""Most effects assumed while the noise is bounded."""
DOUBTFUL = 0.03
"""Share of the motion (deviation of the velocities, in the median over columns) from which on noise that differences
show may be motion itself."""
LOWER = 0.5
"""The bound is used where it lies below this share of what differences say, in the median over columns."""


def is_coarse(recordings: list[Recording], model: mujoco.MjModel, noise: Noise) -> bool:
    """Whether rows hold whole states several of the model's timesteps apart, and differences show suspicious noise."""
    period = float(np.median(np.concatenate([np.diff(r.time) for r in recordings])))
    if period < 1.9 * model.opt.timestep or not holds_states(recordings, model, noise):
        return False
    known = np.isfinite(noise.qvel)
    moving = np.nanstd(np.concatenate([r.known("qvel")[:, known] for r in recordings]), axis=0)
    return bool(known.any() and np.median(noise.qvel[known] / np.maximum(moving, 1e-12)) > DOUBTFUL)


def holds_states(recordings: list[Recording], model: mujoco.MjModel, noise: Noise) -> bool:
    """Whether every row tells the velocity wherever it tells a position."""
    if any(r.qvel is None for r in recordings):
        return False
    placed = np.isfinite(column_scale(noise, model)[: model.nv])
    for r in recordings:
        residual = np.isnan(r.known("qvel")).any(0) & placed & _measured(r, model)
        if residual.any():
            return False
    return True


def as_large_as_motion(recordings: list[Recording], noise: Noise) -> Noise:
    """Noise of which nothing is known but that it is less than the motion: what `bound` starts from."""
    rows = [np.concatenate([r.known(k) for r in recordings]) for k in ("qpos", "qvel")]
    seen = [np.isfinite(x) for x in rows]
    spread = [
        np.maximum(np.where(s, x, -np.inf).max(0) - np.where(s, x, np.inf).min(0), 0.0)
        for x, s in zip(rows, seen, strict=True)
    ]
    known = np.isfinite(noise.qvel)
    return replace(
        noise,
        qpos=np.maximum(spread[0], SIGMA_FLOOR),
        qvel=np.where(known, np.maximum(spread[1], SIGMA_VELOCITY_FLOOR), np.inf),
    )


def _measured(r: Recording, model: mujoco.MjModel) -> Array:
    """[nv] whether the position of a degree of freedom was measured."""
    missing = np.isnan(r.qpos).any(0)
    out = np.ones(model.nv, bool)
    for j in range(model.njnt):
        out[model.dof_jntid == j] = not missing[slice(*qpos_columns(model, j))].any()
    return out


def states_as_measured(recordings: list[Recording], model: mujoco.MjModel, noise: Noise) -> list[States]:
    """The measurements themselves as states, with the noise as their covariance."""
    out = []
    scale = column_scale(noise, model)
    for r in recordings:
        qpos = np.where(np.isnan(r.qpos), model.qpos0, r.qpos)
        qvel = np.nan_to_num(r.known("qvel"))
        qacc = np.gradient(qvel, r.time, axis=0)
        cov = np.zeros((r.time.size, model.nv, 2, 2))
        for k in range(2):
            part = scale[k * model.nv : (k + 1) * model.nv]
            cov[:, :, k, k] = np.where(np.isfinite(part), part, 1.0) ** 2
        out.append(States(qpos, qvel, qacc, cov))
    return out


def bound(
    sim: Simulator, sources: tuple[Source, ...], noise: Noise, terms: list[Term], dt: float, seed: int
) -> Noise:
    """The noise, lowered where single intervals are predicted better than differences of rows would allow.

    Args:
        sources: recordings for which `is_coarse` holds. terms: effects that may be missing. dt: step (s).
    """
    recordings = [s.recording for s in sources]
    raw = tuple(
        replace(s, states=x)
        for s, x in zip(sources, states_as_measured(recordings, sim.model, noise), strict=True)
    )
    period = float(np.median(np.concatenate([np.diff(r.time) for r in recordings])))
    w = cut(raw, sim.model, noise, period, INTERVALS, dt, np.random.default_rng([seed, 11]))
    if w.count < 10:
        return noise
    best = NOTHING
    level = _level(sim, best, w)
    for _ in range(DEPTH):
        if _size(level) <= _size(_floor(sim.model.nv)):
            break
        candidates = screen(sim, best, terms, w, _scaled(w, level))[:KEEP]
        found = [_settle(sim, f, w, level) for f in candidates]
        if not found:
            break
        new, lower = min(found, key=lambda x: _size(x[1]))
        if _size(lower) > _size(level) + np.log(LOWER):
            break
        best, level = new, lower
    many = cut(raw, sim.model, noise, period, INTERVALS_IN_THE_END, dt, np.random.default_rng([seed, 12]))
    return _lowered(noise, _of_one_row(sim, best, many, seed), sim.model)


def _size(level: Array) -> float:
    seen = np.isfinite(level)
    return float(np.mean(np.log(level[seen]))) if seen.any() else 0.0


def _level(sim: Simulator, f: Fitted, w: Windows) -> Array:
    """Typical miss [2 nv] of a hypothesis by column; infinite where nothing was measured."""
    residual = sim.residuals([Run(f.hypothesis, f.theta)], w)[0]
    return np.maximum(_typical(residual), _floor(sim.model.nv))


def _of_one_row(sim: Simulator, f: Fitted, w: Windows, seed: int) -> Array:
    """Noise [2 nv] of one row, by column, if nothing else makes a hypothesis miss: predictions miss by the noise of the
    row that they are compared with, and by what the noise of the row that they start from has become."""
    nv, rng, run = sim.model.nv, np.random.default_rng([seed, 13]), [Run(f.hypothesis, f.theta)]
    level = _level(sim, f, w)
    known = np.where(np.isfinite(level), level, 0.0)
    own, sigma = sim.residuals(run, w)[0], known / np.sqrt(2.0)
    drawn = rng.standard_normal((w.count, 2 * nv))
    for _ in range(ROUNDS):
        change = sigma * drawn
        moved = replace(w, q0=integrate(sim.model, w.q0, change[:, :nv]), v0=w.v0 + change[:, nv:])
        became = _typical(sim.residuals(run, moved)[0] - own)
        rest = known**2 - np.where(np.isfinite(became), became, 0.0) ** 2
        # half of the way: too much noise in one column leaves too little for the next round of the others
        sigma = np.sqrt(0.5 * (sigma**2 + np.maximum(rest, (LEAST * known) ** 2)))
    return np.where(np.isfinite(level), np.maximum(sigma, _floor(nv)), level)


def _typical(residual: Array) -> Array:
    """Deviation [2 nv] of the usual residual [W, N, 2 nv] by column; infinite where nothing was measured."""
    out = np.full(residual.shape[-1], np.inf)
    for c in range(out.size):
        value = np.abs(residual[..., c][np.isfinite(residual[..., c])])
        if value.size:
            out[c] = MAD * float(np.median(value))
    return out


def _floor(nv: int) -> Array:
    return np.repeat([SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR], nv)


def _scaled(w: Windows, level: Array) -> Whitener:
    """Residuals in units of `level`, nothing marginalised."""
    nv = level.size // 2
    seen = np.concatenate(
        [np.broadcast_to(w.seen[..., None], (*w.seen.shape, nv)), np.isfinite(w.qvel)], axis=-1
    )
    seen = (seen & np.isfinite(level)).reshape(w.count, -1)
    none = np.zeros((w.count, 1))
    return Whitener(
        np.broadcast_to(level, (*w.seen.shape, level.size)),
        np.zeros((*seen.shape, 1)),
        none,
        seen,
        np.maximum(seen.sum(1), 1).astype(float),
        np.ones(w.count),
        np.zeros(seen.shape),
    )


def _settle(sim: Simulator, f: Fitted, w: Windows, level: Array) -> tuple[Fitted, Array]:
    """Fit in units of what the fit itself still misses, a few times over."""
    for _ in range(3):
        f = fit(sim, [f], w, _scaled(w, level), iterations=3)[0]
        lower = _level(sim, f, w)
        if _size(lower) > _size(level) + np.log(0.8):
            return f, np.minimum(lower, level)
        level = lower
    return f, level


def _lowered(noise: Noise, level: Array, model: mujoco.MjModel) -> Noise:
    scale = column_scale(noise, model)
    seen = np.isfinite(level) & np.isfinite(scale)
    if not seen.any() or np.median(level[seen] / scale[seen]) > LOWER:
        return noise
    lower = np.minimum(scale, level)
    qpos, qvel = noise.qpos.copy(), np.minimum(noise.qvel, level[model.nv :])
    for j in range(model.njnt):
        q, v = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        kind = int(model.jnt_type[j])
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            qpos[q : q + 4] = np.minimum(qpos[q : q + 4], lower[v : v + 3].max() / 2)
        elif kind == mujoco.mjtJoint.mjJNT_FREE:
            qpos[q : q + 3] = np.minimum(qpos[q : q + 3], lower[v : v + 3])
            qpos[q + 3 : q + 7] = np.minimum(qpos[q + 3 : q + 7], lower[v + 3 : v + 6].max() / 2)
        else:
            qpos[q] = min(qpos[q], lower[v])
    quantised = noise.quantum / np.sqrt(12)
    return replace(noise, qpos=np.maximum(qpos, quantised), qvel=qvel, direct=True, stamp=0.0)
