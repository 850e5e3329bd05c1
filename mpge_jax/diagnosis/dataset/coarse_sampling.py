"""Noise of logs whose samples lie too far apart for their differences to show it (transitions of a learner's task).

High-order differences take motion between two rows for noise: at 20 rows a second a running machine seems to be
measured to a tenth of a radian. Where velocities were recorded too, every pair of rows is a prediction of its own:
from the state as measured, over one interval. What the best hypothesis misses there holds the noise of both rows and
whatever physics is still missing, so it bounds the noise from above; the lower of the two bounds is taken. What no
effect explains, where forces leave far less than any, is kept out by these, of any size at two joints at most: the
others tell the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.one_interval import Assumed, least_misses, mean_logarithm, misses, of_one_row
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.missing_force import active_dofs
from mpge_jax.diagnosis.estimation.screening import screen
from mpge_jax.diagnosis.estimation.whitening import Whitener, column_scale
from mpge_jax.diagnosis.machine.model import qpos_columns
from mpge_jax.diagnosis.recordings.measurement_noise import SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR, Noise
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States, follow_equalities
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
Told = tuple[Assumed, np.ndarray]
"""What is assumed, and what is missed [2 nv] with it."""
INTERVALS = 40
"""Pairs of rows that are predicted."""
INTERVALS_IN_THE_END = 300
"""And in the end, when the hypothesis is chosen."""
KEEP = 5
DEPTH, WEIGHED = 2, 3
"""Most effects, and most unknown forces, that are assumed while the noise is bounded; and how often they are fitted, in
units of what the last fit missed."""
DOUBTFUL = 0.03
"""Share of the motion (deviation of the velocities, in the median over columns) from which on noise that differences
show may be motion itself."""
CLEARLY = 0.8
"""Share to which misses must fall, in the mean over columns, to have fallen."""
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
        states = States(qpos, qvel, qacc, cov)
        follow_equalities(r, states, model)
        out.append(states)
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
    start = Assumed(), misses(sim, Assumed(), w)

    def effects(assumed: Assumed, missed: Array) -> list[Told]:
        candidates = screen(sim, assumed.fit, terms, w, _scaled(w, missed))[:KEEP]
        return [_settle(sim, f, w, missed) for f in candidates]

    def forces(assumed: Assumed, missed: Array) -> list[Told]:
        dofs = [d for d in active_dofs(sim.model) if d not in assumed.pushed]
        tried = [replace(assumed, pushed=(*assumed.pushed, d)) for d in dofs]
        return [(x, _among_itself(sim, x, w, missed)) for x in tried]

    assumed, missed = _lowest(start, effects, LOWER)
    pushed, beside = _lowest(start, forces, CLEARLY)
    # an effect that takes half of it away may be only like what acts
    far_less = mean_logarithm(beside) < mean_logarithm(missed) + np.log(LOWER)
    if far_less or not assumed.fit.hypothesis.terms:
        assumed, missed = pushed, beside
    many = cut(raw, sim.model, noise, period, INTERVALS_IN_THE_END, dt, np.random.default_rng([seed, 12]))
    return _lowered(noise, of_one_row(sim, assumed, many, missed, seed), sim.model)


def _lowest(told: Told, further: Callable[[Assumed, Array], list[Told]], share: float) -> Told:
    """What misses least with some more assumed, one thing after the other, as long as misses fall to a share by it."""
    for _ in range(DEPTH):
        missed = told[1]
        if mean_logarithm(missed) <= mean_logarithm(least_misses(missed.size // 2)):
            break
        found = further(*told)
        if not found:
            break
        lowest = min(found, key=lambda x: mean_logarithm(x[1]))
        if mean_logarithm(lowest[1]) > mean_logarithm(missed) + np.log(share):
            break
        told = lowest
    return told


def _among_itself(sim: Simulator, assumed: Assumed, w: Windows, missed: Array) -> Array:
    """Misses beside forces that are fitted in units of these."""
    for _ in range(WEIGHED):
        missed = misses(sim, assumed, w, missed)
    return missed


def _scaled(w: Windows, missed: Array) -> Whitener:
    """Residuals in units of `missed`, nothing marginalised."""
    nv = missed.size // 2
    seen = np.concatenate(
        [np.broadcast_to(w.seen[..., None], (*w.seen.shape, nv)), np.isfinite(w.qvel)], axis=-1
    )
    seen = (seen & np.isfinite(missed)).reshape(w.count, -1)
    none = np.zeros((w.count, 1))
    return Whitener(
        np.broadcast_to(missed, (*w.seen.shape, missed.size)),
        np.zeros((*seen.shape, 1)),
        none,
        seen,
        np.maximum(seen.sum(1), 1).astype(float),
        np.ones(w.count),
        np.zeros(seen.shape),
    )


def _settle(sim: Simulator, f: Fitted, w: Windows, missed: Array) -> Told:
    """Fit in units of what the fit itself still misses, a few times over."""
    for _ in range(WEIGHED):
        f = fit(sim, [f], w, _scaled(w, missed), iterations=3)[0]
        lower = misses(sim, Assumed(f), w)
        if mean_logarithm(lower) > mean_logarithm(missed) + np.log(CLEARLY):
            return Assumed(f), np.minimum(lower, missed)
        missed = lower
    return Assumed(f), missed


def _lowered(noise: Noise, missed: Array, model: mujoco.MjModel) -> Noise:
    scale = column_scale(noise, model)
    seen = np.isfinite(missed) & np.isfinite(scale)
    if not seen.any() or np.median(missed[seen] / scale[seen]) > LOWER:
        return noise
    lower = np.minimum(scale, missed)
    qpos, qvel = noise.qpos.copy(), np.minimum(noise.qvel, missed[model.nv :])
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
