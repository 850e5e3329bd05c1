"""What is named, beside the functions that stand for what has no name: an effect that then only does harm goes."""

from __future__ import annotations

from dataclasses import replace

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, error_drops, fit_report, left_out
from mpge_jax.diagnosis.residual.model import ResidualModel, with_residual
from mpge_jax.diagnosis.residual.motion import residual_of_motion
from mpge_jax.diagnosis.selection.confirmation import refitted
from mpge_jax.diagnosis.selection.procedure import Decision, with_fewer
from mpge_jax.diagnosis.selection.search_state import Search

HARM = "beside the force that nobody named, recordings are predicted no better with it"


def without_harm(
    p: Prepared, s: Search, found: Decision, at: list[str], residual: ResidualModel, held: FitReport
) -> Decision:
    """What was found, without the effects without which the test recordings are predicted no worse.

    One is taken away at a time; the others are fitted again beside the functions, and the functions beside them.

    Args:
        at: where something is left. residual: its functions beside what was found. held: the windows that count.
    """
    f, gone = found.fit, list[Term]()
    while f.hypothesis.named:
        drops = error_drops(p, with_residual(p.ctx, f, residual), held.windows, f.hypothesis.named)
        worst = min(drops, key=lambda t: drops[t])
        if drops[worst] > 0.0:
            break
        functions = with_residual(p.ctx, NOTHING, residual)
        beside = replace(s, sim=s.sim.beside(functions.hypothesis, functions.theta))
        fewer = refitted(beside, f.of_terms(p.ctx, f.hypothesis.without(worst)))
        its = residual_of_motion(p, s, fewer, at, (p, fewer), fit_report(p, fewer, "test"))
        if its is None or its.after > residual.after:
            break
        f, residual, gone = fewer, its, [*gone, worst]
    if not gone:
        return found
    p.warnings += left_out(gone, HARM)
    return with_fewer(p, s, found, f)
