"""Which of the effects that training recordings need are confirmed by forces that nothing was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce

import numpy as np

from mpge_jax.diagnosis.effects.candidates import plain_form
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.held_out_error import BY_CHANCE, MAY_BE_NONE, left_out
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, by_scatter
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.bank import Bank
from mpge_jax.diagnosis.force_balance.force_errors import rms
from mpge_jax.diagnosis.force_balance.force_search import LEAST
from mpge_jax.diagnosis.force_balance.procedure import (
    SOMETHING,
    beside_inexact_inertias,
    fitted,
    leaving_plain,
    sureness,
)

Array = np.ndarray


def confirmed(bank: Bank, fit: Fitted, b: Balance, masses_within: float) -> tuple[Fitted, list[str]]:
    """The fit with what is confirmed, its intervals as wide as inexact masses make them; and what is said of the rest.

    Args:
        bank: regression of the recordings to which the others are fitted again. b: forces that nothing was fitted to.
        masses_within: share by which given masses and inertias may be off.
    """

    def refitted(f: Fitted, term: Term) -> Fitted:
        return _fitted_without(bank, f, term)

    def wide(f: Fitted) -> Fitted:
        return beside_inexact_inertias(bank.balance, f, masses_within)

    fit, by_chance = _reduced(b, _as_plain(bank, fit, b), lambda f: _by_chance(b, f), refitted)
    fit, unsure = _reduced(
        b, wide(fit), lambda f: _unsure(bank.balance, f), lambda f, t: wide(refitted(f, t))
    )
    return fit, left_out(by_chance, BY_CHANCE) + left_out(unsure, MAY_BE_NONE)


def without(b: Balance, parts: dict[Term, Array], term: Term) -> Array:
    """Predicted forces [N, nu] without one of the effects, the others as they are."""
    return b.predicted({t: x for t, x in parts.items() if t != term})


def _as_plain(bank: Bank, fit: Fitted, b: Balance) -> Fitted:
    """The fit with plain friction in place of every law of it by which the forces of `b` are not predicted better:
    beyond doubt, be it of one joint or of all that have the law, and no worse where joints rest, which friction
    holds."""
    laws = [t for t, x in fit.hypothesis.split(b.ctx, fit.theta).items() if plain_form(b.ctx, t, x)]
    together = set()
    for kind in {t.id for t in laws}:
        each = [t for t in laws if t.id == kind]
        plain = reduce(lambda f, t: _fitted_without(bank, f, t), each, fit)
        if beyond_doubt(_evidence(b, _wrong(b, plain), _wrong(b, fit))):
            together.add(kind)
    for term in laws:
        if term not in fit.hypothesis.terms:
            continue
        plain = _fitted_without(bank, fit, term)
        gain = _evidence(b, _wrong(b, plain), _wrong(b, fit))
        better = gain > 0.0 if term.id in together else beyond_doubt(gain)
        if not better or _of_all_rows(b, fit) > _of_all_rows(b, plain):
            fit = plain
    return fit


def _of_all_rows(b: Balance, fit: Fitted) -> float:
    """Mean logarithm of the actuators' errors, rows included in which joints rest."""
    wrong = rms(b.predicted_by(fit) - b.measured)
    return float(np.log(wrong[np.isfinite(wrong)] + 1e-300).mean())


def _reduced(
    b: Balance,
    fit: Fitted,
    weakest: Callable[[Fitted], Iterable[Term]],
    refitted: Callable[[Fitted, Term], Fitted],
) -> tuple[Fitted, list[Term]]:
    """The fit without its weak effects, and those effects. One is taken away at a time, as others may stand in for it,
    and stays where it is `_needed`: `b` may not tell two apart that the recordings of the regression do.

    Args:
        weakest: the weak effects of a fit, the weakest first. refitted: a fit without one of its effects.
    """
    gone: list[Term] = []
    needed: set[Term] = set()
    weak = weakest(fit)
    while rest := [t for t in weak if t not in needed]:
        other = refitted(fit, rest[0])
        if _needed(b, fit, other):
            needed.add(rest[0])
        else:
            gone.append(rest[0])
            fit, weak = other, weakest(other)
    return fit, gone


def _by_chance(b: Balance, fit: Fitted) -> list[Term]:
    """The effects by which the forces of `b` are not predicted better, those that help least first."""
    parts, left = fit.hypothesis.split(b.ctx, fit.theta), _wrong(b, fit)
    gains = {t: _evidence(b, without(b, parts, t) - b.telling, left) for t in parts}
    return sorted((t for t in parts if not beyond_doubt(gains[t])), key=lambda t: gains[t])


def _unsure(b: Balance, fit: Fitted) -> list[Term]:
    """The effects that are no surer than nothing, the least sure first."""
    sure = {t: sureness(b, fit, t) for t in fit.hypothesis.terms}
    return sorted((t for t in sure if sure[t] <= SOMETHING), key=lambda t: sure[t])


def _fitted_without(bank: Bank, fit: Fitted, term: Term) -> Fitted:
    """The others fitted again; a law of friction leaves the plain one that it contains."""
    ctx = bank.balance.ctx
    return fitted(bank, leaving_plain(ctx, fit.hypothesis.split(ctx, fit.theta), term))


def _needed(b: Balance, fit: Fitted, other: Fitted) -> bool:
    """Whether the forces of `b` are predicted much worse by `other`."""
    left, wrong = _wrong(b, fit), _wrong(b, other)
    share = 1.0 - (rms(left) / np.maximum(rms(wrong), 1e-300)) ** 2
    return beyond_doubt(_evidence(b, wrong, left)) and bool(np.nanmax(share) > LEAST)


def _wrong(b: Balance, fit: Fitted) -> Array:
    """Errors [N, nu] of the forces that tell."""
    return b.predicted_by(fit) - b.telling


def _evidence(b: Balance, without: Array, left: Array) -> float:
    """Logarithm of the likelihood ratio by which the squared error of forces falls with one effect, the others kept, in
    units of what is left of each actuator's, block by block.

    Args:
        without, left: [N, nu] errors without the effect, and with all.
    """
    unit = np.maximum(rms(left), 1e-12 * rms(b.telling))
    blocks = np.bincount(b.block, np.nansum((without**2 - left**2) / unit**2, 1))
    return by_scatter(blocks)
