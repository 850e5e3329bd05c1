"""Force that is missing in recordings, piece by piece: points beside a function that was fitted to others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.residual.force import driven_by
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.missing_force import missing
from mpge_jax.diagnosis.evidence.folds import folds
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.residual.inputs import since_turns, values_along, values_of
from mpge_jax.diagnosis.residual.model import Function
from mpge_jax.diagnosis.simulation.single_step import Machine

Array = np.ndarray
LENGTHS = (0.03, 0.06, 0.12, 0.25)
"""Lengths (s) of the pieces over each of which a constant force is told from a motion."""
FINE = 0.1
"""Uncertainty of a force, over the spread of the function's, that is fine enough: a longer piece blurs the function."""
ODD = 5.0
"""Times the usual uncertainty from which on a piece tells nothing."""
MOST = 300
"""Points at most."""


@dataclass(frozen=True)
class Points:
    """force: [N] on the joint, in N or N m. inputs: of the function, each [N]."""

    force: Array
    inputs: tuple[Array, ...]


@dataclass(frozen=True)
class Pieces:
    """force: [N] on the joint that is missing in each piece, taken for constant. unsure: [N] its standard errors.
    values: of every input (`Axis.key`) amid the piece, each [N]. fold: [N] part to which it belongs (`folds`)."""

    force: Array
    unsure: Array
    values: dict[str, Array]
    fold: Array

    def beside(self, function: Function) -> Points:
        """What is missing of the function's own kind: of dry friction, force against the motion."""
        against = function.effect.against(self.values)
        return Points(against * self.force, tuple(self.values[a.key] for a in function.axes))


def missing_in_motion(p: Prepared, f: Fitted, function: Function) -> Points:
    """What windows of the held-out recordings lack with the named effects alone: in each a constant force, with the
    start as uncertain as it is."""
    effect = function.effect
    found = Points(np.zeros(0), tuple(np.zeros(0) for _ in effect.axes))
    for these in pieces(p, "test", f, function.term.place):
        found = these.beside(function)
        if np.median(these.unsure) < FINE * np.std(effect.value(np, function.theta, list(found.inputs))):
            break
    return found


def pieces(p: Prepared, part: Part, f: Fitted, place: Place) -> Iterator[Pieces]:
    """What pieces of one part's recordings lack, with the start as uncertain as it is: of each of the `LENGTHS` in
    turn for which a recording is long enough."""
    along: list[dict[str, Array]] = []
    for length in LENGTHS:
        w = p.windows(part, length, MOST)
        if not w.count:
            continue
        along = along or [values_of(p, s, place) for s in w.sources]
        middle = w.start + 0.5 * w.times.max(1)
        values = {
            key: np.array(
                [
                    np.interp(t, w.sources[s].recording.time, along[s][key])
                    for s, t in zip(w.source, middle, strict=True)
                ]
            )
            for key in along[0]
        }
        force, unsure = (x[:, p.ctx.dof(place)] for x in missing(p.sim, f, w, p.noise))
        sure = unsure < ODD * np.median(unsure)
        fold = folds(w.recording[sure], w.start[sure])
        yield Pieces(force[sure], unsure[sure], {key: x[sure] for key, x in values.items()}, fold)


def missing_in_forces(p: Prepared, f: Fitted, held: ForceErrors, function: Function) -> Points:
    """What the measured forces of a given motion lack with the named effects alone, row by row.

    Args:
        held: errors of `f`.
    """
    missing = held.corrected - held.balance.telling
    return rows_of(p, held.balance, f, missing, function.term.place).beside(function)


def rows_of(p: Prepared, b: Balance, f: Fitted, missing: Array, place: Place) -> Pieces:
    """What the rows of a balance lack at a joint: at most `MOST` of them, each as uncertain as the others.

    Args:
        missing: [N, nu] forces that `f` needs beyond those that were measured (NaN: none).
    """
    parts = f.hypothesis.split(p.ctx, f.theta)
    # what an actuator gives is its gain times what was measured
    m = Machine.build(p.ctx, tuple(parts), tuple(parts.values())).model
    q, v = (np.concatenate([getattr(t, key) for t in b.tracks]) for key in ("q", "v"))
    force = np.zeros(len(missing))
    for a in driven_by(p.ctx, place):
        force = force + m.actuator_gear[a, 0] * m.actuator_gainprm[a, 0] * missing[:, a]
    kept = np.flatnonzero(np.isfinite(force))
    kept = kept[:: max(1, -(-kept.size // MOST))]
    turns = [since_turns(p, place, t.q) for t in b.tracks]
    values = values_along(p, place, q[kept], v[kept])
    values |= {key: np.concatenate([t[key] for t in turns])[kept] for key in turns[0]}
    return Pieces(force[kept], np.ones(kept.size), values, b.fold[b.block[kept]])
