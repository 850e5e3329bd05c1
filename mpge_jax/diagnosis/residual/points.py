"""Force that is missing in held-out recordings where a function was fitted to others: points beside that function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.residual import driven_by, residual_of
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.missing_force import missing
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.residual.inputs import values_along, values_of
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


def missing_in_motion(p: Prepared, f: Fitted, function: Function) -> Points:
    """What windows of the held-out recordings lack with the named effects alone: in each a constant force, with the
    start as uncertain as it is."""
    place, effect = function.term.place, residual_of(function.term.id)
    dof = p.ctx.dof(place)
    names = [a.input for a in effect.axes]
    along = [values_of(p, s, place) for s in p.test]
    found = Points(np.zeros(0), tuple(np.zeros(0) for _ in names))
    for length in LENGTHS:
        w = p.windows("test", length, MOST)
        if not w.count:
            continue
        middle = w.start + 0.5 * w.times.max(1)
        inputs = tuple(
            np.array(
                [
                    np.interp(t, p.test[s].recording.time, along[s][name])
                    for s, t in zip(w.source, middle, strict=True)
                ]
            )
            for name in names
        )
        force, unsure = (x[:, dof] for x in missing(p.sim, f, w, p.noise))
        usual = float(np.median(unsure))
        sure = unsure < ODD * usual
        found = Points(force[sure], tuple(x[sure] for x in inputs))
        if usual < FINE * np.std(effect.value(np, function.theta, list(inputs))):
            break
    return found


def missing_in_forces(p: Prepared, f: Fitted, held: ForceErrors, function: Function) -> Points:
    """What the measured forces of a given motion lack with the named effects alone, row by row.

    Args:
        held: errors of `f`.
    """
    place, names = function.term.place, [a.input for a in function.axes]
    parts, tracks = f.hypothesis.split(p.ctx, f.theta), held.balance.tracks
    # what an actuator gives is its gain times what was measured
    m = Machine.build(p.ctx, tuple(parts), tuple(parts.values())).model
    q, v = (np.concatenate([getattr(t, key) for t in tracks]) for key in ("q", "v"))
    missing = held.corrected - held.balance.measured
    force = sum(
        m.actuator_gear[a, 0] * m.actuator_gainprm[a, 0] * missing[:, a] for a in driven_by(p.ctx, place)
    )
    kept = np.flatnonzero(np.isfinite(force))
    kept = kept[:: max(1, -(-kept.size // MOST))]
    values = values_along(p, place, q[kept], v[kept])
    return Points(np.asarray(force)[kept], tuple(values[name] for name in names))
