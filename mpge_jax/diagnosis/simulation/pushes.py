"""Generalised forces from outside that tell what a machine answers: constant along windows, or in a part of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Push:
    """A constant generalised force.

    Attributes:
        dof: on which it acts. force: in N or N m. begin, end: of the part of every window in which it acts, as shares.
    """

    dof: int
    force: float
    begin: float = 0.0
    end: float = 1.0


def by_step(pushes: Iterable[tuple[Push, Array]], simulations: int, nv: int, steps: int) -> dict[int, Array]:
    """What pushes simulations [n, nv], by the step (the first one: 0) from which on it does, in their order.

    Args:
        pushes: each with the numbers of the simulations on which it acts.
    """
    acting = [(round(p.begin * steps), round(p.end * steps), p, rows) for p, rows in pushes]
    changes = {0, *(k for begin, end, _, _ in acting for k in (begin, end) if k < steps)}
    out = {k: np.zeros((simulations, nv)) for k in sorted(changes)}
    for begin, end, p, rows in acting:
        for k, push in out.items():
            if begin <= k < end:
                push[rows, p.dof] += p.force
    return out
