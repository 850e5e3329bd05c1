"""Which candidate is chosen, and whether its terms are needed."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, ndtri

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.evidence.scored import Scored, clearly_worse, evidence, held_out_evidence
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.thresholds import MOVES, NAMED


def choose(s: Search, ranked: list[Scored], without: Hypothesis = Hypothesis()) -> Scored:  # noqa: B008
    """The simplest candidate within two standard errors of the best, of those whose new terms are `named`."""
    ranked = [r for r in ranked if named(s, r.fit, without)] or ranked
    tied = [r for r in ranked if not clearly_worse(r, ranked[0])]
    return min(tied, key=lambda r: (*r.complexity, r.losses.mean()))


def accept(s: Search, new: Scored, old: Scored) -> bool:
    """Whether the new terms improve held-out windows beyond doubt, and their parameters differ from null."""
    first = not old.fit.hypothesis.terms
    further = len(new.fit.hypothesis.terms) - len(old.fit.hypothesis.terms)
    return (
        needed(new, old, len(s.terms), further)
        and named(s, new.fit, old.fit.hypothesis)
        and (first or moves(s, new.fit, old.fit))
    )


def needed(new: Scored, old: Scored, among: int = 1, effects: int = 1) -> bool:
    """Whether held-out windows are predicted better beyond doubt with the terms that `new` has and `old` lacks: so many
    `effects`, each the best of so many candidates."""
    return beyond_doubt(held_out_evidence(new, old), among, effects)


def missed(more: Scored, less: Scored) -> bool:
    """Whether windows are predicted worse beyond doubt by `less`, which lacks some of the terms of `more`: by all of
    them, as nothing was chosen among candidates, but for half a unit that each further parameter of `more` gains by
    being fitted to them (Akaike, "A new look at the statistical model identification", 1974). Of the forms of an effect
    one was chosen: between those, windows that neither was fitted to decide.
    """
    if _effects(more) == _effects(less):
        return needed(more, less)
    fitted = 0.5 * max(more.fit.theta.size - less.fit.theta.size, 0)
    return beyond_doubt(evidence(more, less) - fitted)


def _effects(r: Scored) -> set[tuple[str, Place]]:
    """The effects of a fit with their places, in whatever form."""
    return {(t.plain, t.place) for t in r.fit.hypothesis.terms}


def moves(s: Search, new: Fitted, old: Fitted) -> bool:
    """Whether `new` moves the predictions of `old` by more than a detail, at the joint where most."""
    nv = s.sim.model.nv
    fits = (NOTHING, old, new)
    res = s.sim.residuals([Run(f.hypothesis, f.theta) for f in fits], s.held)[..., :nv]
    seen = np.isfinite(res).all(0)
    nominal, before, after = np.where(seen, np.clip(res, -1e3, 1e3), 0.0)
    change = np.sqrt(((after - before) ** 2).sum((0, 1)))
    error = np.sqrt((nominal**2).sum((0, 1)))
    return bool((change > MOVES * error)[error > 0].any())


def named(s: Search, f: Fitted, without: Hypothesis = Hypothesis()) -> bool:  # noqa: B008
    """Whether every added term differs clearly from what its effect vanishes in."""
    return all(z >= NAMED for term, z in strength(s, f).items() if term not in without.terms)


def may_be_none(s: Search, f: Fitted) -> list[Term]:
    """Named effects of which 95 % intervals hold that there is none, the weakest first."""
    size = {t: z for t, z in strength(s, f).items() if t.effect.named and z <= WITHIN}
    return sorted(size, key=lambda t: size[t])


def strength(s: Search, f: Fitted) -> dict[Term, float]:
    """By how many deviations each term's `contrasts`, together or the best by itself, differ from null."""
    ctx, out = s.sim.ctx, {}
    for term, part in zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True):
        contrasts = term.effect.contrasts(ctx, term.place)
        if not len(contrasts) or not f.cov.size:
            out[term] = np.inf
            continue
        delta = contrasts @ (f.theta[part] - term.effect.null(ctx, term.place))
        cov = contrasts @ f.cov[part, part] @ contrasts.T
        deviation = np.sqrt(np.maximum(np.diag(cov), 1e-300))
        # of a wave, amplitude and phase may be known where neither of its two parts is
        z = delta / deviation
        correlation = cov / np.outer(deviation, deviation)
        together = z @ np.linalg.pinv(correlation, rcond=1e-8, hermitian=True) @ z
        # as unlikely as that many deviations of one number
        alike = -ndtri(0.5 * chdtrc(len(z), max(together, 0.0)))
        out[term] = max(float(np.abs(z).max()), float(alike))
    return out
