"""All masses times a factor, and all drives weaker by it: where nothing given resists, the same motion."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted


def by_a_common_factor(
    ctx: Context, terms: list[Term], f: Fitted, term: Term
) -> tuple[Fitted, tuple[Term, ...]] | None:
    """`f` with all drives in place of all masses, or with all masses in place of all drives; forces beside them change
    by the factor too. None if it has neither.

    Args:
        terms: what may act. term: what stands for all masses, or the first of the gains of all drives.

    Returns:
        it, to begin a fit with, and what stands in it for `term` and the other gains.
    """
    parts = f.hypothesis.split(ctx, f.theta)
    masses = [t for t in terms if t.id == "mass_scale" and t.place.kind == "world"]
    gains = [t for t in f.hypothesis.named if t.id == "actuator_gain"]
    if term in masses:
        gone, come = [term], [t for t in terms if t.id == "actuator_gain"]
        told = float(parts[term][0])
    elif gains[:1] == [term]:
        gone, come = gains, masses
        told = float(np.mean([parts[t][0] for t in gains]))
    else:
        return None
    without = Hypothesis.of(*(t for t in f.hypothesis.terms if t not in gone))
    come = [t for t in come if compatible(without, t)]
    # of a single drive `same_in_principle` knows it
    drives = max(len(gone), len(come))
    if not 1 < ctx.model.nu <= drives or not come or told <= 0.0:
        return None
    factor = 1.0 / told
    others = dict.fromkeys(come, np.array([factor]))
    for t in without.terms:
        force = [any(x in p.unit for x in ("N", "kg")) for p in t.params(ctx)]
        others[t] = np.where(force, factor * parts[t], parts[t])
    return f.exchanged(ctx, gone, others), tuple(come)
