"""Encoders whose zeros differ from recording to recording.

Encoders are zeroed anew before a session (often where friction happens to hold a link, a few degrees from where it
would hang), a belt skips a tooth, a link is clamped a degree further on its shaft. No physics explains what that
leaves: the zeros of a recording are a matter of that recording, like its noise, and no effect of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Place, default_places, joint_unit
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import Whitener, whitener
from mpge_jax.diagnosis.machine.model import scalar_joints
from mpge_jax.diagnosis.selection.all_joints import IN_EVERY_JOINT
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows, cut

Array = np.ndarray
WINDOWS, FEWEST = 200, 6
"""Windows at most, and of each recording at least."""
RECORDINGS = 3
"""Recordings that it takes to compare them."""
ROUNDS, ITERATIONS, STEPS = 3, 4, 2
"""How often parameters and zeros are fitted in turn, and steps of each."""
STEP, WIDTH = 5e-3, 1.0
"""Differences (rad or m) of the slopes, and deviation of the weak prior of a zero."""
DIFFERS, TOLD = 6.0, 3.0
"""Deviations by which a zero must differ somewhere, and from which on it then counts."""
AROUND = 3.0
"""Typical distances from their median within which the training recordings' zeros lie around the model's."""
HALF = 0.5
"""Share of such a recording's usual chi^2 that its own zeros may leave at most, and of all recordings' together theirs:
else zeros only take a part of something else."""
LARGEST = 0.25
"""Zeros (rad; of slides, in lengths of the machine) above which something else is taken for them."""
NEAR = 0.01
"""Share of a joint's travel within which it is at the end of it."""
FIRST = 1 / 3
"""Part of a test recording that tells its zeros."""
SLIGHT, SHOWN = 0.1, 8
"""Share of a recording's largest zero below which one is not worth a word, and recordings that a warning lists."""


@dataclass(frozen=True)
class _Group:
    """Windows of R logs with enough of them.

    Attributes:
        windows: of all of them. of: [W] to which of the R each belongs. train: [R] whether parameters are fitted to
            some of it. names: of the R. joints: J of them. columns: [J] of qpos, theirs.
    """

    windows: Windows
    of: Array
    train: Array
    names: tuple[str, ...]
    joints: list[Place]
    columns: list[int]

    def less(self, zeros: Array) -> Windows:
        """The windows with zeros [R, J] taken off."""
        w, off = self.windows, np.zeros((len(self.windows.sources), self.windows.qpos.shape[2]))
        off[w.source[:, None], self.columns] = zeros[self.of]
        sources = tuple(_less(s, z) for s, z in zip(w.sources, off, strict=True))
        return replace(w, sources=sources, q0=w.q0 - off[w.source], qpos=w.qpos - off[w.source, None])

    def usual(self, excess: Array) -> Array:
        """Median [R] of what windows [W] show, by recording."""
        return np.array([np.median(excess[self.of == r]) for r in range(self.train.size)])


def other_zeros(p: Prepared, f: Fitted) -> dict[str, Array]:
    """By how much the encoders of a recording read more [nq] (rad or m) than they should, where recordings differ.

    The zeros of each recording are fitted to its own windows, and where that helps one of them, in turn with the
    parameters of `f`, and of friction, damping and rotor inertia in every joint, which are fitted to the training
    recordings. Nothing is said of machines whose parts strike each other: impacts tell zeros badly.
    """
    group = None if p.sim.rugged(f.hypothesis) else _group(p)
    if group is None:
        return {}
    common, zeros = np.zeros(len(group.columns)), np.zeros((group.train.size, len(group.columns)))
    for k in range(1 + ROUNDS):
        if k:
            train = group.less(zeros - common).take(group.train[group.of])
            f = fit(p.sim, [_with_plain(p, f)], train, _white(p, f, train), iterations=ITERATIONS)[0]
        white = _white(p, f, group.less(zeros))
        for _ in range(STEPS):
            zeros, deviation = _step(p, f, group, white, zeros)
        common = _common(zeros[group.train])
        own, shared = (
            group.usual(white.excess(_flat(p, f, white, group.less(z))))
            for z in (zeros, 0.0 * zeros + common)
        )
        if not (own < HALF * shared).any():
            return {}
    apart = np.abs(zeros - common) / deviation
    if not ((apart.max(1) > DIFFERS) & (own < HALF * shared)).any() or own.sum() > HALF * shared.sum():
        return {}
    those = np.flatnonzero(apart.max(1) > TOLD)
    hinges = np.array([p.model.jnt_type[j.index] == mujoco.mjtJoint.mjJNT_HINGE for j in group.joints])
    if (np.abs(zeros - common)[those] > LARGEST * np.where(hinges, 1.0, p.ctx.length)).any():
        return {}
    out = {}
    for r in those:
        out[group.names[r]] = np.zeros(p.model.nq)
        out[group.names[r]][group.columns] = zeros[r] - common
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
        before = max(s.spent, FIRST * s.recording.duration)
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
    """Joints with bearings whose position was measured in every recording."""
    measured = np.all([~np.isnan(s.recording.qpos).any(0) for s in p.sources], axis=0)
    return [j for j in default_places(p.ctx, "joint") if measured[p.ctx.qadr(j)]]


def _group(p: Prepared) -> _Group | None:
    """What recordings can be compared by."""
    sources, joints = p.sources, _joints(p)
    rng = np.random.default_rng([p.config.seed, 29])
    w = cut(sources, p.model, p.noise, p.config.decide_s, WINDOWS, p.dt, rng)
    w = w.take(~_at_stops(p, w) & _may_tell(p, w))
    logs = np.array([s.recording.log for s in sources])[w.source] if w.count else np.zeros(0, str)
    names = [n for n in dict.fromkeys(logs) if (logs == n).sum() >= FEWEST]
    train = np.isin(names, [s.recording.log for s in p.train])
    if len(names) < RECORDINGS or not train.any() or not joints:
        return None
    w, logs = w.take(np.isin(logs, names)), logs[np.isin(logs, names)]
    of = np.array([names.index(n) for n in logs])
    return _Group(w, of, train, tuple(map(str, names)), joints, [p.ctx.qadr(j) for j in joints])


def _may_tell(p: Prepared, w: Windows) -> Array:
    """Windows [W] that may be looked at for zeros: of test recordings those at the beginning, where no other stretch of
    the log tells them."""
    told = {s.recording.log for s in p.looked_at}
    until = [
        -np.inf if s.recording.log in told else s.recording.time[0] + FIRST * s.recording.duration
        for s in w.sources
    ]
    early = w.start + w.times.max(1, initial=0.0) <= np.array(until)[w.source]
    return (w.source < len(p.looked_at)) | early


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


def _common(zeros: Array) -> Array:
    """The zeros [J] of the usual training recording, from theirs [R, J]: the model's, where they lie around those."""
    middle = np.median(zeros, axis=0)
    around = AROUND * np.median(np.abs(zeros - middle), axis=0)
    return np.where(np.abs(middle) > around, middle, 0.0)


def _white(p: Prepared, f: Fitted, w: Windows) -> Whitener:
    return whitener(p.sim, f.hypothesis, f.theta, w, p.noise)


def _flat(p: Prepared, f: Fitted, white: Whitener, w: Windows) -> Array:
    """Whitened residuals [W, M]."""
    return white(p.sim.residuals([Run(f.hypothesis, f.theta)], w)[0])


def _step(p: Prepared, f: Fitted, group: _Group, white: Whitener, zeros: Array) -> tuple[Array, Array]:
    """A robust Gauss-Newton step of all recordings' zeros [R, J], and their deviations [R, J] that allow for misfit."""
    now = _flat(p, f, white, group.less(zeros))
    steps = STEP * np.eye(zeros.shape[1])
    slopes = np.stack([(_flat(p, f, white, group.less(zeros + h)) - now) / STEP for h in steps], -1)
    weight = 1.0 / (1.0 + white.excess(now) / 5.0)
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
