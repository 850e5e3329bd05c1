"""Which functions are worth fitting, and how finely: as the force looks which short pieces of recordings lack."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.evidence.folds import FOLDS
from mpge_jax.diagnosis.residual.points import Pieces
from mpge_jax.diagnosis.residual.regression import Choice, Rows, fewest, smoothed

Array = np.ndarray
HINTS = 4
"""Functions beside those of one input of the joint, at most, that are worth fitting."""
FINER = {1: ((0,), (18,), (36,)), 2: ((0, 0), (18, 0), (0, 18))}
"""Values along each input that are tried, of one and of two inputs; 0: as usual. More are for what is narrow."""
OF_A_TURN = ((72,), (144,))
"""More of these, along the angle within a turn: teeth, notches and poles repeat many times in one."""


def hinted(candidates: list[Residual], place: Place, tried: Iterable[Pieces]) -> list[Residual]:
    """Forces of one input of the joint itself, and those of the other functions, of which there may be hundreds, that
    explain most of the force which pieces lack, told from other pieces; of those with two inputs also what one of these
    explains alone, as the other may add nothing. Travels since a turn are much alike, whatever the farthest one is:
    they are half of those at most. What repeats within a turn, however often, is one of the others.

    Args:
        tried: pieces of several lengths. The length counts at which most is explained: short pieces are blurred by
            noise, long ones by the motion.

    Returns:
        them, with as many values as the pieces show.
    """
    plain = [
        e
        for e in candidates
        if len(e.axes) == 1 and e.axes[0].parts == 1 and not (e.coupled or e.dry or e.traced)
    ]
    others = [e for e in candidates if e not in plain]
    best: tuple[float, list[Residual]] = (0.0, [])
    telling = [these for these in tried if these.force.size >= 2 * FOLDS and these.force.any()]
    for these in telling if others else ():
        told = sorted(((_promised(e, place, these), k) for k, e in enumerate(others)), reverse=True)
        alike = [k for _, k in told if others[k].traced][HINTS // 2 :]
        if told[0][0] > best[0]:
            some = [others[k] for share, k in told if share > 0.0 and k not in alike]
            best = told[0][0], some[:HINTS]
    alone = [e for e in others if e not in best[1] and any(_is_part(e, whole) for whole in best[1])]
    return [_as_fine_as_seen(e, place, telling) for e in plain + best[1] + alone]


def _is_part(one: Residual, whole: Residual) -> bool:
    """Whether a function has one of the two inputs of another."""
    return len(one.axes) < len(whole.axes) and one.dry == whole.dry and one.axes[0] in whole.axes


def variants(effect: Residual) -> list[Residual]:
    """The function with each of the `FINER` values, the usual ones first."""
    turn = len(effect.axes) == 1 and effect.axes[0].around and effect.axes[0].parts == 1
    return [effect.told_by(knots) for knots in FINER[len(effect.axes)] + (OF_A_TURN if turn else ())]


def _promised(effect: Residual, place: Place, these: Pieces) -> float:
    """What a function explains with as many values as explain most: with few, what is narrow looks like any other. Of
    two inputs of several joints there are too many functions for that."""
    tried = [effect] if len(effect.axes) == 2 and effect.coupled else variants(effect)
    return max(_explained(e, place, these)[0] for e in tried)


def _as_fine_as_seen(effect: Residual, place: Place, telling: list[Pieces]) -> Residual:
    """The function with as many values as the pieces show by which most is explained."""
    told = [[_explained(e, place, these) for e in variants(effect)] for these in telling]
    if not told:
        return effect
    return fewest([choice for _, choice in max(told, key=lambda t: max(share for share, _ in t))]).effect


def _explained(effect: Residual, place: Place, these: Pieces) -> tuple[float, Choice]:
    """Share of the squared force, in units of its standard errors, that a function told from other pieces explains."""
    parts = np.array(effect.basis(np, [these.values[a.key] for a in effect.axes]))
    columns = parts * effect.against(these.values) / these.unsure
    missing = these.force / these.unsure
    weight = 1.0 / (1.0 + missing**2 / np.median(missing**2))
    choice = smoothed(effect, place.index, Rows(columns, -missing, weight), these.fold)
    return 1.0 - float(choice.left.sum() / (weight @ missing**2)), choice
