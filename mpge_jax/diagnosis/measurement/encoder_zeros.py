"""Encoders whose zeros differ from recording to recording.

Encoders are zeroed anew before a session (often where friction happens to hold a link, a few degrees from where it
would hang), a belt skips a tooth, a link is clamped a degree further on its shaft. No physics explains what that
leaves: the zeros of a recording are a matter of that recording, like its noise, and no effect of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Place, default_places, joint_unit
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_weight, whitener
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.machine.model import scalar_joints
from mpge_jax.diagnosis.measurement.between_recordings import between_recordings
from mpge_jax.diagnosis.selection.all_joints import IN_EVERY_JOINT
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
WINDOWS, FEWEST = 200, 2
"""Windows at most, and of each part of a recording at least."""
RECORDINGS, PARTS = 3, 3
"""Recordings that it takes to compare them, and parts of equal length of each, which tell zeros by themselves."""
ROUNDS, ITERATIONS, STEPS = 3, 4, 2
"""How often parameters and zeros are fitted in turn, and steps of each."""
STEP, WIDTH = 5e-3, 1.0
"""Differences (rad or m) of the slopes, and deviation of the weak prior of a zero."""
NEAR = 0.01
"""Share of a joint's travel within which it is at the end of it."""
SLIGHT, SHOWN = 0.1, 8
"""Share of a recording's largest zero below which one is not worth a word, and recordings that a warning lists."""


@dataclass(frozen=True)
class _Group:
    """Windows of P parts of R logs.

    Attributes:
        windows: of all of them. of: [W] to which of the P each belongs. log: [P] to which of the R each belongs.
        looked: [R] whether it is no test recording. train: [R] whether parameters are fitted to some of its log.
        names: of the R. columns: [J] of qpos, those of the joints.
    """

    windows: Windows
    of: Array
    log: Array
    looked: Array
    train: Array
    names: tuple[str, ...]
    columns: list[int]

    def less(self, zeros: Array) -> Windows:
        """The windows with zeros [P, J] taken off."""
        w, off = self.windows, np.zeros((len(self.windows.sources), self.windows.qpos.shape[2]))
        off[w.source[:, None], self.columns] = zeros[self.of]
        sources = tuple(_less(s, z) for s, z in zip(w.sources, off, strict=True))
        return replace(w, sources=sources, q0=w.q0 - off[w.source], qpos=w.qpos - off[w.source, None])

    def fitted_to(self, zeros: Array) -> Windows:
        """Of the windows with zeros [P, J] taken off, those that parameters are fitted to."""
        return self.less(zeros).take(self.train[self.log][self.of])


def other_zeros(p: Prepared, f: Fitted) -> dict[str, Array]:
    """By how much the encoders of a recording read more [nq] (rad or m) than they should, where recordings differ.

    The parts of each recording tell its zeros each by itself, in turn with the parameters of `f`, and of friction,
    damping and rotor inertia in every joint, which are fitted to the training recordings. A zero is the same in all
    parts of a recording: what the model misses otherwise shifts one part here and the next one there. Nothing is said
    of machines whose parts strike each other: impacts tell zeros badly.
    """
    group = None if p.sim.rugged(f.hypothesis) else _group(p)
    if group is None:
        return {}
    own, common = np.zeros((len(group.names), len(group.columns))), np.zeros(len(group.columns))
    for k in range(1 + ROUNDS):
        if k:
            train = group.fitted_to(own[group.log])
            f = fit(p.sim, [_with_plain(p, f)], train, _white(p, f, train), iterations=ITERATIONS)[0]
        zeros = (own + common)[group.log]
        white = _white(p, f, group.less(zeros))
        for _ in range(STEPS):
            zeros, deviation = _step(p, f, group, white, zeros)
        joints = [
            between_recordings(z, d, group.log, group.looked)
            for z, d in zip(zeros.T, deviation.T, strict=True)
        ]
        differ = np.array([beyond_doubt(x.ratio, len(joints)) for x in joints])
        if not differ.any():
            return {}
        own = np.where(differ, np.array([x.own for x in joints]).T, 0.0)
        common = np.array([x.common for x in joints])
    out = {name: np.zeros(p.model.nq) for name in group.names}
    for name, its in zip(group.names, own, strict=True):
        out[name][group.columns] = its
    return out


def with_zeros(p: Prepared, zeros: dict[str, Array]) -> Prepared:
    """The same with the logs' `other_zeros` taken off; what told those of a test recording is spent."""
    told = {s.recording.log for s in p.looked_at}

    def again(s: Source) -> Source:
        if s.recording.log not in zeros:
            return s
        less = _less(s, zeros[s.recording.log])
        if s.recording.log in told:
            return less
        before = max(s.spent, s.recording.duration / PARTS)
        return replace(less, recording=replace(less.recording, before=before))

    return p.mapped(again)


def describe_zeros(p: Prepared, zeros: dict[str, Array]) -> str:
    """A warning, with those recordings that differ most."""
    ranked = sorted(zeros, key=lambda name: -np.abs(zeros[name]).max())
    parts = []
    for name in ranked[:SHOWN]:
        each = []
        for j in _joints(p):
            value, unit = float(zeros[name][p.ctx.qadr(j)]), joint_unit(p.ctx, j, "rad", "m")
            if abs(value) > SLIGHT * np.abs(zeros[name]).max():
                each.append(f"{abs(value):.2g} {unit} {'more' if value > 0 else 'less'} at the {j.name}")
        parts.append(f"{name} reads {' and '.join(each)}")
    if len(zeros) > SHOWN:
        parts.append(f"{len(zeros) - SHOWN} more differ less")
    return (
        f"the encoders' zeros differ between recordings: {'; '.join(parts)}. Each is estimated from its own recording, "
        "of held-out ones from the first third, which they are then not judged by, and taken off it. It is no effect "
        "of the model; a load that only some recordings had may look like it."
    )


def _with_plain(p: Prepared, f: Fitted) -> Fitted:
    """`f` with friction, damping and rotor inertia in every joint: what it has not found yet is not to shift zeros."""
    hypothesis, parts, centres = f.hypothesis, *(f.hypothesis.split(p.ctx, x) for x in (f.theta, f.centre))
    for term in (Term(i, j) for i in IN_EVERY_JOINT for j in _joints(p)):
        if compatible(hypothesis, term):
            hypothesis = hypothesis.with_term(term)
            parts[term] = centres[term] = np.asarray(term.effect.starts(p.ctx, term.place))[0]
    return Fitted(hypothesis, hypothesis.gather(p.ctx, parts), hypothesis.gather(p.ctx, centres))


def _joints(p: Prepared) -> list[Place]:
    """Joints with bearings whose position was measured in every recording, but those of servos that act on what is
    read, zeros and all."""
    measured = np.all([~np.isnan(s.recording.qpos).any(0) for s in p.sources], axis=0)
    servos = p.model.actuator_trnid[list(p.sim.on_readings), 0]
    return [j for j in default_places(p.ctx, "joint") if measured[p.ctx.qadr(j)] and j.index not in servos]


def _group(p: Prepared) -> _Group | None:
    """What recordings can be compared by."""
    sources, joints = p.sources, _joints(p)
    rng = np.random.default_rng([p.config.seed, 29])
    w = cut(sources, p.model, p.noise, p.config.decide_s, WINDOWS, p.dt, rng)
    log, part = _log_and_part(p, w)
    keep = (part >= 0) & ~_at_stops(p, w)
    told, of, count = np.unique(
        np.stack([log, part], 1)[keep], axis=0, return_inverse=True, return_counts=True
    )
    enough = count >= FEWEST
    names = [s.recording.log for s in sources]
    those = np.unique(told[enough, 0])
    train = np.isin([names[r] for r in those], [s.recording.log for s in p.train])
    if train.sum() < RECORDINGS or not joints:
        return None
    return _Group(
        w.take(np.flatnonzero(keep)[enough[of]]),
        (np.cumsum(enough) - 1)[of][enough[of]],
        np.searchsorted(those, told[enough, 0]),
        looked=those < len(p.looked_at),
        train=train,
        names=tuple(names[r] for r in those),
        columns=[p.ctx.qadr(j) for j in joints],
    )


def _log_and_part(p: Prepared, w: Windows) -> tuple[Array, Array]:
    """The log [W] of every window, as the index of the first source that is a stretch of it, and the part [W] of it in
    which the window ends; -1 where it may not be looked at: a test recording but for its first part, and all of one of
    whose log there are other stretches."""
    looked, out = len(p.looked_at), np.full((2, w.count), -1)
    logs = [s.recording.log for s in w.sources]
    for first in (k for k, log in enumerate(logs) if logs.index(log) == k):
        stretches = [
            k for k, log in enumerate(logs) if log == logs[first] and (k < looked or first >= looked)
        ]
        times = [w.sources[k].recording.time for k in stretches]
        begin, end = min(t[0] for t in times), max(t[-1] for t in times)
        those = np.isin(w.source, stretches)
        part = (PARTS * (w.start + w.times.max(1, initial=0.0) - begin) / (end - begin)).astype(int)
        part = np.minimum(part, PARTS - 1)
        if first >= looked:
            part = np.where(part == 0, part, -1)
        out[0, those], out[1, those] = first, part[those]
    return out[0], out[1]


def _at_stops(p: Prepared, w: Windows) -> Array:
    """Windows [W] in which a joint comes to the end of its travel: they tell where that is, not the zero."""
    m, out = p.model, np.zeros(w.count, bool)
    for j in (j for j in scalar_joints(m) if m.jnt_limited[j]):
        q, (low, high) = w.qpos[..., m.jnt_qposadr[j]], m.jnt_range[j]
        out |= ((q < low + NEAR * (high - low)) | (q > high - NEAR * (high - low))).any(1)
    return out


def _less(s: Source, zero: Array) -> Source:
    """The same recording with a zero [nq] taken off its positions."""
    recording = replace(s.recording, qpos=s.recording.qpos - zero)
    return s.rebuilt(recording=recording, states=replace(s.states, qpos=s.states.qpos - zero))


def _white(p: Prepared, f: Fitted, w: Windows) -> Whitener:
    return whitener(p.sim, f.hypothesis, f.theta, w, p.noise)


def _flat(p: Prepared, f: Fitted, white: Whitener, w: Windows) -> Array:
    """Whitened residuals [W, M]."""
    return white(p.sim.residuals([Run(f.hypothesis, f.theta)], w)[0])


def _step(p: Prepared, f: Fitted, group: _Group, white: Whitener, zeros: Array) -> tuple[Array, Array]:
    """A robust Gauss-Newton step of all parts' zeros [P, J], and their deviations [P, J] that allow for misfit."""
    now = _flat(p, f, white, group.less(zeros))
    steps = STEP * np.eye(zeros.shape[1])
    slopes = np.stack([(_flat(p, f, white, group.less(zeros + h)) - now) / STEP for h in steps], -1)
    weight = robust_weight(white.excess(now))
    new, deviation = zeros.copy(), np.zeros(zeros.shape)
    for r in range(len(zeros)):
        k = group.of == r
        gram = np.einsum("w,wmi,wmj->ij", weight[k], slopes[k], slopes[k]) + np.eye(len(steps)) / WIDTH**2
        scores = weight[k, None] * np.einsum("wmi,wm->wi", slopes[k], now[k])
        bread = np.linalg.inv(gram)
        spread = bread @ (scores.T @ scores) @ bread
        new[r] -= bread @ scores.sum(0)
        deviation[r] = np.sqrt(np.maximum(np.diag(spread), np.diag(bread)))
    return new, deviation
