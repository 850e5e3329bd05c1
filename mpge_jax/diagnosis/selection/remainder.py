"""What a hypothesis leaves of a search's windows, and whether that is more than noise would."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.initial_states import settled
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss, usual_excess
from mpge_jax.diagnosis.evidence.null_distribution import Floor, Left
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.thresholds import ELSEWHERE_FROM


@dataclass(frozen=True)
class Remainder:
    """What a fit leaves that is more than noise.

    Attributes:
        fit: what leaves it. search: whose windows, some of which may start elsewhere than estimated. left: its losses
            on them. whites: of training and held-out windows.
    """

    fit: Fitted
    search: Search
    left: Left
    whites: tuple[Whitener, Whitener]


def remainder(s: Search, f: Fitted, noise: Floor, thorough: bool = True) -> Remainder | None:
    """What `f` leaves of the windows if that is more than the noise would, wherever within their uncertainty these
    start. Where things strike each other a slight change of the start may make a window another one.

    Args:
        thorough: look for the starts of the worst windows from elsewhere too.
    """
    found = leaves(s, f, noise.past)
    rugged = s.sim.rugged(f.hypothesis)
    ordinary, work = ELSEWHERE_FROM * max(usual_excess(noise.loss), 1.0), s.sim.work
    for elsewhere in (False, True) if thorough else (False,):
        if not (rugged and noise.beyond(found.left)):
            break
        windows = found.search.train, found.search.held
        moved = [settled(s.sim, f, w, s.noise, ordinary, elsewhere, s.seed) for w in windows]
        if all(new is old for new, old in zip(moved, windows, strict=True)):
            break
        found = leaves(replace(s, train=moved[0], held=moved[1]), f, noise.past)
    # by its work so far a search decides how widely it looks for effects, and this was none of it
    s.sim.work = work
    return found if noise.beyond(found.left) else None


def leaves(s: Search, f: Fitted, past: float = 0.0) -> Remainder:
    """What `f` leaves, noise included. Windows with less than `past` s before them do not count, if others do."""
    whites, losses = s.whiten(f, temper=False), []
    for w, white in zip((s.train, s.held), whites, strict=True):
        flat = white(s.sim.residuals([Run(f.hypothesis, f.theta)], w))[0]
        losses.append(robust_loss(white.excess(flat)))
    typical = np.ones(s.train.count + s.held.count, bool)
    typical[s.typical : s.train.count] = s.typical is None
    told = np.concatenate([w.past for w in (s.train, s.held)]) > past - 1e-9
    left = Left(np.concatenate(losses), typical, told if (told & typical).any() else np.ones_like(typical))
    s.log.append(f"left by {f.hypothesis}: loss {left.losses[typical & left.told].mean():.3f}")
    return Remainder(f, s, left, whites)
