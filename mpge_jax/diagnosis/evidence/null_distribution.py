"""What the statistics look like when a hypothesis is true: simulate recordings from it and treat them alike."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mpge_jax.diagnosis.dataset.coarse_sampling import states_as_measured
from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.prediction_error import noise_floor
from mpge_jax.diagnosis.estimation.whitening import (
    column_scale,
    in_finer_steps,
    robust_loss,
    whitener_beside,
)
from mpge_jax.diagnosis.machine.joint_space import columns_of, integrate
from mpge_jax.diagnosis.machine.model import compile_variable, has_plain_law
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States, smoothed
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.actuator_state import activations
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import plain_force
from mpge_jax.diagnosis.simulation.guided import led
from mpge_jax.diagnosis.simulation.windows import HISTORY, Windows
from mpge_jax.diagnosis.thresholds import BEYOND_NOISE, BY_CHANCE, DOUBT, LOUD, SEVERAL

Array = np.ndarray
SEGMENT, ROWS, ALL = 0.8, 14, 1_000_000
"""Seconds and rows of a segment, at least; and rows that none has."""
SEGMENTS = 16
"""Segments, at most."""
WITHIN = 0.45
"""Share of a segment that a window cut from it has at most."""


@dataclass(frozen=True)
class Floor:
    """What a true hypothesis would leave.

    Attributes:
        loss, error: mean of the windows' losses and its standard error. losses: [W] those losses.
        ratio: usual error relative to `noise_floor`, which takes start state and measurements for independent (they
            are not: the state was smoothed from the same measurements), at most 1.
        missed: root-mean-square error of all windows relative to that, where impacts weigh.
        by_dof: [nv] mean loss of each degree of freedom by itself (empty: one for each).
        past: seconds, at least, that were recorded before each of these windows, where that tells how they begin.
    """

    loss: float = 1.0
    error: float = 0.05
    ratio: float = 1.0
    missed: float = 1.0
    losses: Array = field(default_factory=lambda: np.array([BY_CHANCE]))
    by_dof: Array = field(default_factory=lambda: np.zeros(0))
    past: float = 0.0

    def loud(self, by_dof: Array) -> Array:
        """At which degrees of freedom mean losses [nv] are far more than that."""
        return by_dof > LOUD * np.maximum(self.by_dof if self.by_dof.size else 1.0, 1.0)

    def exceeded(self, losses: Array) -> bool:
        """Whether windows with these losses [W] show more than that on average, beyond doubt."""
        excess = float(losses.mean()) - max(self.loss, 1.0)
        error = float(losses.std() / np.sqrt(max(losses.size, 1)))
        return bool(excess > DOUBT * np.hypot(error, self.error))

    def far(self, losses: Array) -> bool:
        """Whether several windows [W], of those where the model misses most, are far beyond all that it would leave."""
        most = float(self.losses.max(initial=1.0))
        return bool((losses > BEYOND_NOISE * most).sum() >= SEVERAL)

    def beyond(self, left: Left) -> bool:
        """Whether more is left than that."""
        return self.exceeded(left.losses[left.typical & left.told]) or self.far(left.losses[left.told])


@dataclass(frozen=True)
class Left:
    """What a hypothesis leaves.

    Attributes:
        losses: [W] of all windows. typical: [W] which of them were drawn at random (the others were chosen because the
            nominal model misses most there). told: [W] of which the recording tells how they begin.
    """

    losses: Array
    typical: Array
    told: Array


def floor(prepared: Prepared, f: Fitted, length: float, shaken: Array | None = None) -> Floor:
    """The floor of windows of a length (s) when `f` is the truth, with the same noise (of measured forces too) and
    commands.

    With contacts, the higher one of two truths: as the model steps, and in finer steps, which change impacts more than
    whitening's directions follow.

    Stretches of the training recordings are simulated anew from their own states, noise is added, and they go
    through smoothing, cutting and whitening like the real ones.

    Args:
        shaken: the `force_noise` of these recordings, where it is known already.
    """
    shaken = force_noise(prepared) if shaken is None else shaken
    truths = (False, True) if prepared.ctx.contacts else (False,)
    return max((_floor(prepared, f, length, shaken, finer) for finer in truths), key=lambda x: x.loss)


def _floor(prepared: Prepared, f: Fitted, length: float, shaken: Array, finer: bool) -> Floor:
    sim, rng = prepared.sim, np.random.default_rng([prepared.config.seed, 77])
    # of all their rows: commands averaged over several would count as noise
    segment = max(SEGMENT, length / WITHIN, (ROWS + 2) * prepared.ctx.period)
    prepared = prepared.mapped(lambda s: replace(s, states=s.otherwise[-1]) if s.otherwise else s)
    recalled, w = _segments(prepared, f, segment)
    if not w.count or w.times.shape[1] < ROWS:
        return Floor()
    # the first row of a segment is that after the window's start
    rows = [
        w.sources[k].recording.time.searchsorted(t + 1e-9) for k, t in zip(w.source, w.start, strict=True)
    ]
    along = {k: activations(sim.model, w.sources[k]) for k in set(w.source.tolist())}
    filled = [along[k][row] for k, row in zip(w.source, rows, strict=True)]
    simulated = zip(_simulated(prepared, f, w, rows, shaken, rng, finer), filled, w.source, rows, strict=True)
    kept = [x for x in simulated if (x[0].time > recalled).sum() >= ROWS]
    if not kept:
        return Floor()
    segments = [replace(x[0], before=recalled) for x in kept]
    noise = prepared.noise
    if noise.direct:
        states = states_as_measured(segments, sim.model, noise)
    else:
        jumps = [w.sources[k].states.jumps_in(slice(row, row + r.time.size)) for r, _, k, row in kept]
        states = smoothed(segments, sim.model, noise, jumps)
    sources = tuple(
        _again(r, s, act, w.sources[k], row)
        for r, (_, act, k, row), s in zip(segments, kept, states, strict=True)
    )
    if sim.guided:
        sources = tuple(led(s, sim.model, noise, sim.guided, rng) for s in sources)
    cuts = cut(sources, sim.model, noise, length, 2 * SEGMENTS, prepared.dt, rng)
    if not cuts.count:
        return Floor()
    white = whitener_beside(sim, f.hypothesis, f.theta, cuts, noise, temper=False)
    residual = sim.residuals([Run(f.hypothesis, f.theta)], cuts)[0]
    flat = white(residual)
    loss = robust_loss(white.excess(flat))
    expected = noise_floor(sim, f, cuts, noise, shaken).window
    positions = np.clip(residual[..., : sim.model.nv], -1e3, 1e3)
    seen = np.isfinite(positions).any((1, 2))
    ratio = missed = 1.0
    if seen.any():
        got, expected = np.nanmean(positions[seen] ** 2, axis=(1, 2)), np.maximum(expected[seen], 1e-300)
        ratio = min(float(np.sqrt(np.median(got / expected))), 1.0)
        missed = float(np.sqrt(got.mean() / expected.mean()))
    error, each = (
        float(loss.std() / np.sqrt(max(loss.size, 1))),
        robust_loss(white.by_dof(flat, sim.model.nv)),
    )
    return Floor(float(loss.mean()), error, ratio, missed, loss, each.mean(0), recalled)


def _segments(prepared: Prepared, f: Fitted, seconds: float) -> tuple[float, Windows]:
    """Stretches of training recordings, and the seconds at their beginning that no window shows: what was recorded
    before a window may tell how it begins, and then the floor's windows have it too, where recordings are long enough.
    """
    sim = prepared.sim
    recalled = HISTORY * any(
        t.effect.rugged or t.effect.commands or t.effect.remembers(sim.ctx, t.place, theta[None]).any()
        for t, theta in sim.acting(f.hypothesis, f.theta).items()
    )
    w = prepared.windows("train", duration=recalled + seconds, limit=SEGMENTS, seed=5, samples=ALL)
    return float(np.clip(w.dt * w.steps - seconds, 0.0, recalled)), w


def force_noise(prepared: Prepared) -> Array:
    """Deviation [nu] of the noise in the forces that drive the machine; 0 where commands drive it.

    A command that reacts to noisy measurements makes a force that is as rough and yet real, so what the model expects
    of the actuator is taken away first where that leaves less.
    """
    out = np.zeros(prepared.measured.size)
    plain = compile_variable(prepared.spec)
    times = [s.recording.time for s in prepared.train]
    noisy = prepared.by_force if prepared.known is None else prepared.by_force & ~prepared.known
    for a in map(int, np.flatnonzero(noisy)):
        forces = [s.recording.known("force")[:, a] for s in prepared.train]
        levels = [column_noise(times, forces)[0]]
        if has_plain_law(plain, a) and all(s.recording.ctrl is not None for s in prepared.train):
            expected = [
                plain_force(plain, a, _arrived(s, a), s.states.qpos, s.states.qvel) for s in prepared.train
            ]
            levels.append(column_noise(times, [f - e for f, e in zip(forces, expected, strict=True)])[0])
        finite = [x for x in levels if np.isfinite(x)]
        out[a] = min(finite, default=0.0)
    return out


def _arrived(s: Source, a: int) -> Array:
    """Commands [T, nu] that have reached actuator `a` at the rows of a recording."""
    t, late = s.recording.time, 0.0 if s.late is None else float(s.late[a])
    return s.recording.known("ctrl")[np.maximum(np.searchsorted(t, t - late + 1e-9, side="right") - 1, 0)]


def _again(r: Recording, states: States, act: Array, original: Source, row: int) -> Source:
    """A simulated segment, which begins at that row of a recording, with forces that change between rows as there.
    `r` has the whole command at each row, noise included."""
    rows = slice(row, row + r.time.size)
    command = r.known("ctrl")
    moves = original.smooth.any(0)
    held = original.command[rows] - original.smooth[rows]
    return Source.build(
        r, states, command, np.where(moves, command - held, 0.0), original.age, act, original.late,
        original.bend[rows.start : rows.stop - 1],
    )  # fmt: skip


def _simulated(
    prepared: Prepared,
    f: Fitted,
    w: Windows,
    rows: list[int],
    shaken: Array,
    rng: np.random.Generator,
    finer: bool,
) -> list[Recording]:
    m = prepared.model
    run = [Run(f.hypothesis, f.theta)]
    residual = in_finer_steps(prepared.sim, run, w, 2)[0] if finer else prepared.sim.residuals(run, w)[0]
    out = []
    noise = prepared.noise
    scale = column_scale(noise, m)[: m.nv]
    columns, dofs, _ = columns_of(m)
    step = np.zeros(m.nv)
    step[dofs] = noise.quantum[columns]
    # readings are rounded, as encoders do
    scale = np.where(np.isfinite(scale), np.sqrt(np.maximum(scale**2 - step**2 / 12.0, 0.0)), 0.0)
    coarse = step[dofs] > 0.0
    columns, step = columns[coarse], step[dofs][coarse]
    for k in range(w.count):
        n = int(w.seen[k].sum())
        # tangent vectors from the measured to the simulated position, with fresh noise; unmeasured columns stay so
        change = np.nan_to_num(-residual[k, :n, : m.nv]) + scale * rng.standard_normal((n, m.nv))
        if noise.stamp:
            change = change + w.drift[k, :n] * rng.standard_normal((n, 1))
        time = w.times[k, :n]
        grid, source = w.start[k] + time, w.sources[w.source[k]]
        measured, speeds = w.qpos[k, :n].copy(), w.qvel[k, :n] - residual[k, :n, m.nv :]
        for d in prepared.sim.guided:
            # what is recorded of it, noise included, tells its states anew
            qadr = int(m.jnt_qposadr[m.dof_jntid[d]])
            measured[:, qadr], v = source.state_at(grid, qadr, d)
            speeds[:, d] = v if np.isfinite(noise.qvel[d]) else np.nan
        qpos = integrate(m, measured, change)
        # any reading is on the encoder's grid, and the first one may be missing
        origin = np.fmax.reduce(measured[:, columns], axis=0)
        qpos[:, columns] = origin + np.round((qpos[:, columns] - origin) / step) * step
        velocity = None
        if np.isfinite(speeds).any():
            scatter = np.where(np.isfinite(noise.qvel), noise.qvel, 0.0)
            velocity = speeds + scatter * rng.standard_normal((n, m.nv))
        ctrl = source.mean_command(np.append(grid, grid[-1] + (grid[-1] - grid[-2])))
        # where forces change between rows, they are as at the row, and not on average until the next
        # and those that come late change where they arrive
        whole = source.smooth.any(0)
        whole = whole if source.late is None else whole | (source.late > 0)
        ctrl = np.where(whole, source.command[rows[k] : rows[k] + n], ctrl)
        if shaken.any():
            # the machine felt the force, the recording holds it with noise
            ctrl = ctrl + shaken * rng.standard_normal(ctrl.shape)
        out.append(Recording(f"calibration_{k}", time, qpos, velocity, ctrl if m.nu else np.zeros((n, 0))))
    return out
