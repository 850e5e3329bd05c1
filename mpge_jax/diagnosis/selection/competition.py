"""Candidates against each other: screened, fitted, and each judged under the winner's own whitening."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit, slopes_of
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.evidence.likelihood_ratio import stand_out
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.scored import Scored, hopeful, with_simpler
from mpge_jax.diagnosis.selection.remainder import remainder
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import AT_NOISE, HOPELESS, SETTLED, SEVERAL

Array = np.ndarray
NOISE = Floor()
"""What noise alone leaves where nothing is simulated: one, of all and of each."""
KEEP, KEEP_OF_MANY = 7, 3
"""Candidates that are fitted properly after screening, and beside `MANY` terms."""


def compete(s: Search, base: Fitted, terms: list[Term], keep: int = KEEP) -> tuple[list[Scored], Scored]:
    """Fit the most promising `terms` on top of `base`, each judged under the winner's own whitening.

    Returns the scored candidates, best first by plain loss, and the base scored in the same way.
    """
    white = s.whiten_one(base, s.train)
    if at_noise(s, base, white):
        return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
    terms = [t for t in terms if compatible(base.hypothesis, t)]
    sample = s.sample(base, white)
    slopes = slopes_of(s.sim, base, *sample)
    screened = s.screened(base, sample, terms, slopes)
    before = evaluate(s.sim, [base], *sample)[0].loss
    if base.hypothesis.terms and hopeless(s, screened, before):
        return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
    many = s.brief(base.hypothesis)
    keep = KEEP_OF_MANY if many else keep
    tried = with_simpler(screened, keep)
    fits = hopeful(fit(s.sim, tried, *sample, iterations=4, slopes=slopes, anew=False), before)
    winner = None
    for _ in range(1 if many else 2):
        if not fits or fits[0].hypothesis == winner:
            break
        winner = fits[0].hypothesis
        white = s.whiten_one(fits[0], s.train)
        fits = fit(s.sim, with_simpler(fits, max(keep - 2, 2)), s.train, white, iterations=4)
        fits.sort(key=lambda f: f.loss)
    if not fits:
        return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
    whites = white, s.whiten_one(fits[0], s.held, white.factor)
    scored = s.score([*fits, base], whites)
    ranked = sorted(scored[:-1], key=lambda r: r.losses.mean())
    return ranked, scored[-1]


def hopeless(s: Search, screened: list[Fitted], before: float) -> bool:
    """Whether no quick fit takes away enough of the loss `before` to be looked at further."""
    hope = HOPELESS / max(s.sim.model.njnt, 1)
    return not screened or screened[0].loss > before - hope * min(before, 3.0)


def at_noise(s: Search, base: Fitted, white: Whitener) -> bool:
    """Whether training (under `white`) and held-out windows show nothing but noise, and none stands out."""
    return only_noise(s, base, white) or at_floor(s, base)


def only_noise(s: Search, base: Fitted, white: Whitener) -> bool:
    """Whether losses alone say so, without a simulation of what `base` would leave if it were true."""
    outlying = 0
    for w in (s.train, s.held):
        white = white if w is s.train else s.whiten_one(base, w)
        flat = white(s.sim.residuals([Run(base.hypothesis, base.theta)], w))[0]
        x = white.excess(flat)
        # in a large machine, what one joint lacks drowns in the mean over all
        if loud(white, flat, s.sim.model.nv).any():
            return False
        outlying += int(stand_out(robust_loss(x)).sum())
        # a tempered whitener, or an overestimated noise, says nothing
        little = np.median(x) < 0.5 and not white.inexact
        if white.factor != 1.0 or little or robust_loss(x).mean() > AT_NOISE:
            return False
    return outlying < SEVERAL


def loud(white: Whitener, flat: Array, nv: int, floor: Floor = NOISE) -> Array:
    """Degrees of freedom [nv] at which something may be missing, by whitened residuals [W, M]."""
    return floor.loud(robust_loss(white.by_dof(flat, nv)).mean(0))


def loud_in(s: Search, base: Fitted, w: Windows, floor: Floor = NOISE) -> Array:
    """The same of windows, in units of the noise."""
    white = s.whiten_one(base, w, temper=False)
    flat = white(s.sim.residuals([Run(base.hypothesis, base.theta)], w))[0]
    return loud(white, flat, s.sim.model.nv, floor)


def at_floor(s: Search, base: Fitted) -> bool:
    """Whether `base` leaves no more than it would if it were true. Of the model as given that is asked with
    contacts alone, and where chance leaves much: there a wrong effect finds something to explain."""
    nominal = not base.hypothesis.terms
    if s.floor is None or (nominal and not s.sim.ctx.contacts):
        return False
    floor = s.floor(base)
    if nominal and floor.loss < SETTLED:
        return False
    if remainder(s, base, floor, thorough=False) is not None:
        return False
    # nor at one joint more, which the mean over all does not show
    return not (loud_in(s, base, s.train, floor) & loud_in(s, base, s.held, floor)).any()
