"""What the forces need, decided on training recordings: search and fit in turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import all_terms, compatible, plain_form
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.inexact_inertias import as_wide_as, with_free_inertias
from mpge_jax.diagnosis.force_balance.balance import Along, Balance
from mpge_jax.diagnosis.force_balance.bank import Bank, Entry
from mpge_jax.diagnosis.force_balance.closer_laws import closer_laws
from mpge_jax.diagnosis.force_balance.force_search import Chosen, ForceSearch, Found
from mpge_jax.diagnosis.force_balance.needed_force import can_ask
from mpge_jax.diagnosis.force_balance.polish import polished
from mpge_jax.diagnosis.force_balance.resolution import choose, motion_of
from mpge_jax.diagnosis.force_balance.tracks import Resolution

Array = np.ndarray
PLAIN = ("coulomb_friction", "viscous_damping", "armature", "actuator_bias")
"""Effects of the regression by which the resolution is chosen."""
ROWS = 3000
"""Most rows of a search."""
MOST = 40
"""Most effects."""
TURNS = 3
"""Most turns of search and fit."""
READINGS = 3
"""Most times that the search is made, each with motion and force known as finely as the last one's effects say."""
SOMETHING = 3.0
"""Standard deviations from nothing below which a parameter says nothing."""


@dataclass(frozen=True)
class ForceDecision:
    """What was found.

    Attributes:
        balance: the training recordings. fit: with parameters as the machine itself gives them. search, found: its last
        turn, with rivals in linearised form.
    """

    balance: Balance
    fit: Fitted
    search: ForceSearch
    found: Found

    @property
    def parts(self) -> dict[Term, Array]:
        """Parameters of the effects."""
        return self.fit.hypothesis.split(self.balance.ctx, self.fit.theta)


def decide(p: Prepared, say: Callable[[str], None]) -> ForceDecision:
    """Effects whose forces the recordings need, all but the test ones: parts choose what was fitted to the others.

    How finely motion and force are known is chosen beside plain effects, and again beside those that were found: what
    is missing hides half a row's delay. Where that is another answer the search is made anew.
    """
    terms = [t for t in all_terms(p.ctx, p.config.effects) if can_ask(t)]
    plain = [t for t in terms if t.id in PLAIN]
    if p.config.masses_within:
        terms.append(given_inertias(p.config.masses_within))
    few: dict[Resolution, Along] = {}
    all_rows: dict[Resolution, Along] = {}
    found = _at_resolution(p, terms, choose(p, plain, {}, few), all_rows, say)
    for _ in range(READINGS - 1):
        again = choose(p, plain, found.parts, few)
        if again == found.balance.resolution:
            break
        found = _at_resolution(p, terms, again, all_rows, say)
    lag = found.balance.resolution.lag
    if lag:
        p.warnings.append(
            f"measured forces come late, as through a filter of first order with a time constant of "
            f"{1e3 * lag:g} ms; the forces that they are compared with are delayed alike."
        )
    return found


def _at_resolution(
    p: Prepared,
    terms: list[Term],
    resolution: Resolution,
    along: dict[Resolution, Along],
    say: Callable[[str], None],
) -> ForceDecision:
    """The effects, where motion and force are known as finely as that.

    The search takes every effect as linear near a few starting values; the fit then moves them to where they belong,
    and the search goes on from there, until it stays with what it has.

    Args:
        along: what was computed of motions that are known so finely; it is added to.
    """
    same = along.setdefault(motion_of(resolution), Along.nothing(len(p.looked_at)))
    b = Balance.recorded(p, p.looked_at, ROWS, resolution, same)
    say(f"{len(b.measured)} rows of measured force; {len(terms)} candidates (an effect at a place) to try")
    bank = Bank.of(b, terms)
    chosen: Chosen = ()
    most = MOST if p.config.max_effects is None else p.config.max_effects
    log: list[str] = []
    misleading: set[Entry] = set()
    for _ in range(TURNS):
        search = ForceSearch(bank, say, log, most, frozenset(misleading))
        found = search.run(chosen)
        linear = search.parts(found.best.chosen)
        fit = fitted(bank, linear)
        if {e.term for e in chosen} == set(fit.hypothesis.terms):
            break
        parts = fit.hypothesis.split(p.ctx, fit.theta)
        # linear, what turned out to be no more than the plain law that it contains would seem more again
        gone = {t for t, x in linear.items() if t not in parts and plain_form(p.ctx, t, x)}
        misleading |= {e for e in found.best.chosen if e.term in gone}
        bank = bank.near((t, x) for t, x in parts.items() if len(x) > 1)
        chosen = _entries(bank, parts)
    closer = closer_laws(search, fit.hypothesis.split(p.ctx, fit.theta))
    return ForceDecision(b, fit if closer is None else fitted(*closer), search, found)


def fitted(bank: Bank, parts: dict[Term, Array]) -> Fitted:
    """The best parameters near `parts`, without effects that end up as nothing; those that end up as the plainer ones
    that they contain give way to these."""
    b = bank.balance
    while True:
        f = polished(b, parts, bank.single(parts))
        parts = f.hypothesis.split(b.ctx, f.theta)
        sure = {t: sureness(b, f, t) for t in parts}
        if not sure or min(sure.values()) > SOMETHING:
            return f
        # one at a time, the most elaborate first: of two that are hard to tell apart, neither may seem sure
        unsure = [t for t in sure if sure[t] <= SOMETHING]
        parts = leaving_plain(b.ctx, parts, min(unsure, key=lambda t: (-t.effect.tier, sure[t])))


def leaving_plain(ctx: Context, parts: dict[Term, Array], term: Term) -> dict[Term, Array]:
    """The others, and in the place of a law of friction the plainer ones that it contains."""
    rest = {t: x for t, x in parts.items() if t != term}
    plain, others = plain_form(ctx, term, parts[term]), Hypothesis.of(*rest)
    return rest | {t: x for t, x in plain.items() if compatible(others, t)}


def beside_inexact_inertias(b: Balance, f: Fitted, share: float) -> Fitted:
    """`f` with intervals that hold what masses and inertias that are off by `share` leave open."""
    start = with_free_inertias(b.ctx, f, share)
    if start is None or not f.cov.size:
        return f
    free = polished(b, start.hypothesis.split(b.ctx, start.theta))
    return as_wide_as(b.ctx, f, f, free, share)


def sureness(b: Balance, f: Fitted, term: Term) -> float:
    """By how many standard deviations an effect differs from nothing or, where it contains a plainer one, from that: of
    all its parameters together, as none of them may be sure alone (a mass and where it is)."""
    part = f.hypothesis.slices(b.ctx)[f.hypothesis.terms.index(term)]
    off = f.theta[part] - term.effect.null(b.ctx, term.place)
    contrasts = term.effect.contrasts(b.ctx, term.place) if term.effect.tier > 1 else np.eye(off.size)
    if not contrasts.size:
        return np.inf
    d, cov = contrasts @ off, contrasts @ f.cov[part, part] @ contrasts.T
    return float(np.sqrt(d @ np.linalg.pinv(cov, hermitian=True) @ d / d.size))


def _entries(bank: Bank, parts: dict[Term, Array]) -> Chosen:
    """The last entry of every term: that at its fitted parameters."""
    last = {e.term: e for e in bank.entries}
    return tuple(last[t] for t in parts)
