"""What is left of forces that a given motion needs, as functions fitted by regression."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import DRIVE
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.residual.formula import formula
from mpge_jax.diagnosis.residual.hints import hinted
from mpge_jax.diagnosis.residual.inputs import functions, places_of, seen, turns
from mpge_jax.diagnosis.residual.model import Function, ResidualModel, with_function, worthwhile
from mpge_jax.diagnosis.residual.points import rows_of
from mpge_jax.diagnosis.residual.regression import Blocks, best_function, told

Array = np.ndarray


def residual_of_forces(
    p: Prepared, b: Balance, f: Fitted, at: list[str], held: ForceErrors
) -> ResidualModel | None:
    """The force that `f` lacks at some joints as functions of what goes on there; None where none makes unseen forces
    better predicted.

    Args:
        b: rows to fit to; parts of them choose inputs and smoothness of what was fitted to the others. at: joints at
            which something is left. held: errors of `f` on test recordings.
    """
    found, fitted = [], f
    for place in places_of(p, at):
        function = _function(p, b, fitted, place)
        if function is not None:
            found.append(function)
            fitted = with_function(p.ctx, fitted, function.term, function.theta)
    after = held.of(fitted)
    return worthwhile(found, held.after, after)


def _function(p: Prepared, b: Balance, f: Fitted, place: Place) -> Function | None:
    values = seen(p, place)
    # what a drive gives is what is to be predicted
    known = {k: x for k, x in values.items() if not k.startswith(DRIVE)}
    missing = b.predicted_by(f) - b.telling
    some = hinted(functions(known, turns(p, place)), place, [rows_of(p, b, f, missing, place)])
    best = best_function(told([(e, place.index, _blocks(b, f, e, place)) for e in some], b.fold))
    if best is None:
        return None
    term = Term(best.effect.id, place)
    return Function(term, best.values, formula(best.effect, best.values, values, term, p.ctx))


def _blocks(b: Balance, f: Fitted, effect: Residual, place: Place) -> Blocks:
    """The least-squares problem of a function's values; the force of an actuator in units of what is left of it."""
    term = Term(effect.id, place)
    empty = with_function(b.ctx, f, term)
    parts = empty.hypothesis.split(b.ctx, empty.theta)
    here = b.predicted(parts)
    columns, left = b.columns(parts, term, here), here - b.telling
    known = np.isfinite(left)
    unit = np.sqrt((np.where(known, left, 0.0) ** 2).sum(0) / np.maximum(known.sum(0), 1))
    left, columns = (np.where(known, x, 0.0) / np.maximum(unit, 1e-300) for x in (left, columns))
    count = int(b.block.max()) + 1
    gram, push, whole = (
        np.zeros((count, len(columns), len(columns))),
        np.zeros((count, len(columns))),
        np.zeros(count),
    )
    for k in range(count):
        x, r = columns[:, b.block == k].reshape(len(columns), -1), left[b.block == k].ravel()
        gram[k], push[k], whole[k] = x @ x.T, x @ r, r @ r
    return Blocks(gram, push, whole, np.ones(count))
