"""What is named, beside the functions that stand for what has no name: an effect that then tells nothing goes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.prediction_error import NO_AMOUNTS, Errors, errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, errors_without, fit_report, left_out
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
from mpge_jax.diagnosis.residual.model import ResidualModel, with_residual
from mpge_jax.diagnosis.residual.motion import residual_of_motion
from mpge_jax.diagnosis.selection.confirmation import refitted
from mpge_jax.diagnosis.selection.procedure import Decision, with_fewer
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import REMAINS

HARM = "beside the force that nobody named, recordings are predicted no better with it"


def without_needless(
    p: Prepared,
    s: Search,
    found: Decision,
    at: list[str],
    residual: ResidualModel,
    held: FitReport,
    doubtful: Collection[Term],
) -> tuple[Decision, ResidualModel]:
    """What was found, without the effects without which the test recordings are predicted no worse; and the functions.

    Those that may be a part of what has no name are taken away first, together, where they act on the joint of a
    function alone and recordings are predicted far better for it: beside them the function could not be told. Then
    those with which the errors of the joints are larger are, one at a time. The others are fitted again beside the
    functions, and the functions beside them.

    Args:
        at: where something is left. residual: its functions beside what was found. held: the windows that count.
        doubtful: effects that may be a part of what is left.
    """
    f, gone = found.fit, list[Term]()
    joints = [[function.term.place.index] for function in residual.functions]
    parts = [t for t in doubtful if t in f.hypothesis.named and acted_on(p.model, t.place) in joints]
    fewer = _without(p, s, f, at, residual, parts) if parts else None
    if fewer is not None and fewer[1].after ** 2 <= REMAINS * residual.after**2:
        f, residual = fewer
        gone += parts
    while harmful := _harmful(p, f, residual, held):
        fewer = _without(p, s, f, at, residual, [harmful])
        if fewer is None or _falls(_errors(p, *fewer, held), _errors(p, f, residual, held)) > 0.0:
            break
        f, residual = fewer
        gone.append(harmful)
    if not gone:
        return found, residual
    p.warnings += left_out(gone, HARM)
    return with_fewer(p, s, found, f), residual


def _harmful(p: Prepared, f: Fitted, residual: ResidualModel, held: FitReport) -> Term | None:
    """The effect without which the errors are least, if they are no larger than with it."""
    if not f.hypothesis.named:
        return None
    after = _errors(p, f, residual, held)
    each = errors_without(p, with_residual(p.ctx, f, residual), replace(held, amounts=NO_AMOUNTS))
    falls = {t: _falls(each[t], after) for t in f.hypothesis.named}
    worst = min(falls, key=lambda t: falls[t])
    return worst if falls[worst] <= 0.0 else None


def _errors(p: Prepared, f: Fitted, residual: ResidualModel, held: FitReport) -> Errors:
    return errors(p.sim, with_residual(p.ctx, f, residual), held.windows, p.noise)


def _falls(before: Errors, after: Errors) -> float:
    """By how much the logarithm of a joint's error falls, on average: what has no name is missed by far at its own
    joint, and must not drown what is told at others."""
    return float(np.nanmean(np.log(np.maximum(before.joint, 1e-12) / np.maximum(after.joint, 1e-12))))


def _without(
    p: Prepared, s: Search, f: Fitted, at: list[str], residual: ResidualModel, terms: list[Term]
) -> tuple[Fitted, ResidualModel] | None:
    """The fit without some effects, and the functions beside it, if there are any."""
    functions = with_residual(p.ctx, NOTHING, residual)
    beside = replace(s, sim=s.sim.beside(functions.hypothesis, functions.theta))
    kept = f.hypothesis
    for term in terms:
        kept = kept.without(term)
    fewer = refitted(beside, f.of_terms(p.ctx, kept))
    its = residual_of_motion(p, s, fewer, at, (p, fewer), fit_report(p, fewer, "test"))
    return None if its is None else (fewer, its)
