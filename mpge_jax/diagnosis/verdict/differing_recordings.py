"""Whether what no effect explains is one whose size changes between recordings: a drive or a bearing that warms up."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
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
STRETCHES = 4
"""Stretches of recordings, at least, that are to differ."""
STAYS = 0.5
"""Share of what one size for all leaves, noise aside, that may stay where each stretch has a size of its own."""


def as_recordings_differ(p: Prepared, left: Remainder, at: str) -> str | None:
    """What is left at a joint, in words, where a plain effect there whose size differs between recordings takes most of
    it away; None where none does."""
    if at not in p.names.joints:
        return None
    joint, found = p.names.joints.index(at), []
    for term in left.search.terms:
        if term.id in SIZES and first_joints(p.model, term.place) == {joint}:
            share, sizes = _by_stretch(*_linear(p, left, term))
            if share <= STAYS and len(sizes) >= STRETCHES:
                found.append((share, term, sizes))
    return _told(p, *min(found, key=lambda x: x[0])[1:]) if found else None


def _linear(p: Prepared, left: Remainder, term: Term) -> tuple[Array, Array, Array, Array, float]:
    """Windows' residuals [W, M] in units of the noise, their slopes by an effect's size, the numbers [W] by which
    squares are divided, the stretches [W] that they are of, and the size that all have."""
    s, f = left.search, left.fit
    f = f if term in f.hypothesis.terms else f.beside_nothing(p.ctx, term)
    parts = []
    for late, (w, white) in enumerate(zip((s.train, s.held), left.whites, strict=True)):
        flat = white(s.sim.residuals([Run(f.hypothesis, f.theta)], w)[0])
        stretches = [_stretch(w.sources[k].recording, late) for k in w.source]
        slope = slopes_of(s.sim, f, w, white)[term][0]
        parts.append((flat, slope, white.count * white.expected, np.array(stretches)))
    size = float(f.hypothesis.split(p.ctx, f.theta)[term][0])
    rows = max(x.shape[1] for x, *_ in parts)
    wide = [(*(np.pad(x, ((0, 0), (0, rows - x.shape[1]))) for x in xs[:2]), *xs[2:]) for xs in parts]
    flat, slope, count, stretch = (np.concatenate(x) for x in zip(*wide, strict=True))
    return flat, slope, count, stretch, size


def _stretch(r: Recording, late: int) -> str:
    """Which part of a log it is: what trains is the first part of one, what chooses its last."""
    return f"in {r.name}" if r.part_of is None else f"{'late' if late else 'early'} in {r.part_of}"


def _by_stretch(
    flat: Array, slope: Array, count: Array, stretches: Array, size: float = 0.0
) -> tuple[float, dict[str, tuple[float, float]]]:
    """What an effect with a size for each stretch leaves of windows, noise aside, as a share of what one size for all
    does; and these sizes with their standard errors. Arguments: see `_linear`."""
    x = (flat**2).sum(1) / count
    # a few windows may be missed by more than all others together
    weight = 1.0 / (1.0 + x / max(5.0 * float(x.mean()), 1e-300))

    def fitted(some: Array) -> tuple[float, float, float]:
        r, j, g = flat[some], slope[some], (weight / count)[some]
        square = max(float(g @ (j**2).sum(1)), 1e-300)
        change = -float(g @ (j * r).sum(1)) / square
        scores = g * (j * (r + change * j)).sum(1)
        excess = ((r + change * j) ** 2).sum(1) / count[some] - 1.0
        return (
            change,
            float(np.sqrt((scores**2).sum())) / square,
            float(weight[some] @ np.maximum(excess, 0.0)),
        )

    *_, one = fitted(np.ones(x.size, bool))
    each = {str(k): fitted(stretches == k) for k in np.unique(stretches)}
    # what so many sizes explain by chance
    left = sum(rest for *_, rest in each.values()) * x.size / max(x.size - len(each), 1)
    return left / max(one, 1e-300), {k: (size + change, error) for k, (change, error, _) in each.items()}


def _told(p: Prepared, term: Term, sizes: dict[str, tuple[float, float]]) -> str:
    # where it is surely least, and most
    low = min(sizes, key=lambda k: sizes[k][0] + WITHIN * sizes[k][1])
    high = max(sizes, key=lambda k: sizes[k][0] - WITHIN * sizes[k][1])
    (param,) = term.params(p.ctx)
    unit = "" if param.unit in ("1", "") else f" {param.unit}"
    least, most = (f"{sizes[k][0]:.3g}{unit} {k}" for k in (low, high))
    return f"it is as if {SIZES[term.id].format(term.place.name)} changed between recordings, from {least} to {most}"
