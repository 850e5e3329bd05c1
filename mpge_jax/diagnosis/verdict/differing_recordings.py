"""Whether what is left is a plain effect whose size changes between recordings: a drive or a bearing that warms up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.levenberg_marquardt import slopes_of
from mpge_jax.diagnosis.evidence.joints_of_place import first_joints
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.selection.remainder import Remainder
from mpge_jax.diagnosis.simulation.batch_simulator import Run

Array = np.ndarray
SIZES = {
    "actuator_gain": "the gain of {}",
    "coulomb_friction": "dry friction of the {}",
    "viscous_damping": "damping of the {}",
    "actuator_bias": "the bias of {}",
}
"""Effects of one size, in words."""
STRETCHES, WINDOWS = 3, 4
"""Stretches of recordings, at least, that are compared; and windows, at least, that tell of one."""
STAYS = 0.5
"""Share of what one size for all leaves, noise aside, that may stay where each stretch has a size of its own."""
ODD = 5.0
"""Times what is left of the mean window, from where on a window counts ever less."""


@dataclass(frozen=True)
class Linear:
    """Windows as a linear problem of one effect's size.

    Attributes:
        flat: [W, M] residuals in units of the noise. slope: [W, M] of these by the size.
        count: [W] by which squares are divided, so that noise leaves one. stretch: [W] what each window is of.
        size: that all have.
    """

    flat: Array
    slope: Array
    count: Array
    stretch: Array
    size: float


@dataclass(frozen=True)
class Size:
    """The size in one stretch, and its standard error."""

    value: float
    error: float

    @property
    def most(self) -> float:
        return self.value + WITHIN * self.error

    @property
    def least(self) -> float:
        return self.value - WITHIN * self.error


def as_recordings_differ(p: Prepared, left: Remainder, joint: int) -> str | None:
    """What is left at a joint, in words, where a plain effect there whose size differs between recordings takes most of
    it away; None where none does."""
    found: list[tuple[float, Term, str]] = []
    for term in left.search.terms:
        if term.id in SIZES and first_joints(p.model, term.place) == {joint} and _may_act(left, term):
            share, sizes = by_stretch(_linear(p, left, term))
            told = _told(p, term, sizes) if share <= STAYS and len(sizes) >= STRETCHES else None
            if told is not None:
                found.append((share, term, told))
    if not found:
        return None
    (_, _, first), *others = sorted(found, key=lambda x: x[0])
    # where each recording has a speed of its own, friction is much like damping
    too = [_name(term) for _, term, _ in others]
    return first + (f" (or {' or '.join(too)})" if too else "")


def _may_act(left: Remainder, term: Term) -> bool:
    h = left.fit.hypothesis
    return term in h.terms or compatible(h, term)


def _linear(p: Prepared, left: Remainder, term: Term) -> Linear:
    s, f = left.search, left.fit
    f = f if term in f.hypothesis.terms else f.beside_nothing(p.ctx, term)
    parts = []
    for late, (w, white) in enumerate(zip((s.train, s.held), left.whites, strict=True)):
        flat = white(s.sim.residuals([Run(f.hypothesis, f.theta)], w)[0])
        stretches = [_stretch(w.sources[k].recording, bool(late)) for k in w.source]
        slope = slopes_of(s.sim, f, w, white)[term][0]
        parts.append((flat, slope, white.count * white.expected, np.array(stretches)))
    most = max(flat.shape[1] for flat, *_ in parts)
    wide = [(*(np.pad(x, ((0, 0), (0, most - x.shape[1]))) for x in part[:2]), *part[2:]) for part in parts]
    flat, slope, count, stretch = (np.concatenate(x) for x in zip(*wide, strict=True))
    return Linear(flat, slope, count, stretch, float(f.hypothesis.split(p.ctx, f.theta)[term][0]))


def _stretch(r: Recording, late: bool) -> str:
    """Which part of a log it is: what trains is the first part of one, what chooses its last."""
    return f"{'late' if late else 'early'} in {r.part_of}" if r.part_of else f"in {r.name}"


def by_stretch(x: Linear) -> tuple[float, dict[str, Size]]:
    """What an effect with a size for each stretch leaves of windows, noise aside, as a share of what one size for all
    does (1 where that leaves nothing), and these sizes; of stretches of which too few windows tell, nothing."""
    named, which, windows = np.unique(x.stretch, return_inverse=True, return_counts=True)
    enough = windows[which] >= WINDOWS
    if not enough.any():
        return 1.0, {}
    excess = (x.flat**2).sum(1) / x.count
    # a few windows may be missed by more than all others together
    weight = enough / (1.0 + excess / max(ODD * float(excess.mean()), 1e-300))

    def fitted(some: Array) -> tuple[Size, float]:
        j, r, g = x.slope[some], x.flat[some], (weight / x.count)[some]
        square = max(float(g @ (j**2).sum(1)), 1e-300)
        change = -float(g @ (j * r).sum(1)) / square
        rest = r + change * j
        scores, n = g * (j * rest).sum(1), max(int((g > 0).sum()), 2)
        error = max(np.sqrt((scores**2).sum() * n / (n - 1)) / square, 1.0 / np.sqrt(square))
        beyond = np.maximum((rest**2).sum(1) / x.count[some] - 1.0, 0.0)
        return Size(x.size + change, float(error)), float(weight[some] @ beyond)

    each = {str(named[k]): fitted(which == k) for k in np.flatnonzero(windows >= WINDOWS)}
    one, whole = fitted(enough)[1], int(enough.sum())
    # what so many sizes explain by chance
    left = sum(rest for _, rest in each.values()) * whole / max(whole - len(each), 1)
    return (left / one if one > 0.0 else 1.0), {k: size for k, (size, _) in each.items()}


def _name(term: Term) -> str:
    return SIZES[term.id].format(term.place.name)


def _told(p: Prepared, term: Term, sizes: Mapping[str, Size]) -> str | None:
    """From where it is surely least to where it is surely most; None where these may be alike."""
    low = min(sizes, key=lambda k: sizes[k].most)
    high = max(sizes, key=lambda k: sizes[k].least)
    if sizes[low].most >= sizes[high].least:
        return None
    (param,) = term.params(p.ctx)

    def amount(x: float) -> str:
        if term.id == "actuator_gain":
            return f"{x:.3g} times the model's"
        return f"{abs(x):.3g} {param.unit} {'more' if x >= 0.0 else 'less'} than the model's"

    least, most = (f"{amount(sizes[k].value)} {k}" for k in (low, high))
    return f"it is as if {_name(term)} changed, from {least} to {most}"
