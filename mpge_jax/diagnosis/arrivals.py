"""When, between two rows, a late command reaches its drive.

Forces measured at the rows tell a delay to a whole row only: between two of them a held force changes once, and all
instants at which it may do so fit the rows alike. Which one it is moves the machine by half a row's impulse.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.fitted import Fitted
from mpge_jax.diagnosis.prepare import Prepared
from mpge_jax.diagnosis.simulate import Run
from mpge_jax.diagnosis.source import Source
from mpge_jax.diagnosis.whiten import whitener

Array = np.ndarray
WINDOWS = 60


@dataclass(frozen=True)
class Arrival:
    """Seconds after a row at which the force of the next one begins, 0 to the time between rows, and its deviation."""

    after: float
    deviation: float


def whole_rows(delay: float, period: float) -> int:
    """Rows that surely pass between a command and its force, from a delay fitted to forces at rows: half-way between
    rows or later, as all delays there fit alike."""
    return max(int(np.ceil(delay / period - 0.25)) - 1, 0)


def arriving(source: Source, when: dict[int, float]) -> Source:
    """The same where the held force of each row begins so many seconds after the row before (actuator -> s)."""
    command = source.command.copy()
    late = np.zeros(command.shape[1]) if source.late is None else np.array(source.late, dtype=float)
    for a, seconds in when.items():
        command[:-1, a], late[a] = source.command[1:, a], seconds
    return Source.build(
        source.recording, source.states, command, source.smooth, source.age, source.activation, late, source.bend
    )  # fmt: skip


def with_arrivals(p: Prepared, when: dict[int, Arrival]) -> Prepared:
    """The same machine with forces that begin between rows."""
    after = {a: x.after for a, x in when.items()}
    train, held = (tuple(arriving(s, after) for s in group) for group in (p.train_sources, p.held_sources))
    return replace(p, train_sources=train, held_sources=held)


def arrivals(p: Prepared, f: Fitted, drives: Iterable[int]) -> dict[int, Arrival]:
    """The arrival at each of these drives (of `p`, whose forces begin at their rows) that fits the motion best.

    The motion of a window is linear in it, so it is a weighted least-squares problem in whitened residuals; windows
    that other missing physics disturbs count little.
    """
    drives, h = list(drives), p.ctx.period
    if not drives:
        return {}
    w = p.windows(False, p.config.decide_s, WINDOWS, seed=11)
    run = [Run(f.hypothesis, f.theta)]
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise)
    late = white(p.sim.residuals(run, w))[0]
    columns = []
    for a in drives:
        sources = tuple(arriving(s, {a: 0.0}) for s in w.sources)
        early = white(p.sim.residuals(run, w.driven_by(sources)))[0]
        columns.append((late - early) / h)
    slopes = np.stack(columns, -1)
    seconds = np.full(len(drives), 0.5 * h)
    for _ in range(5):
        left = late + slopes @ (seconds - h)
        weight = 1.0 / (1.0 + white.excess(left) / 5.0)
        gram = np.einsum("w,wmi,wmj->ij", weight, slopes, slopes)
        bread = np.linalg.pinv(gram, hermitian=True)
        best = h - bread @ np.einsum("w,wmi,wm->i", weight, slopes, late)
        seconds = np.clip(best, 0.0, h)
    scores = weight[:, None] * np.einsum("wmi,wm->wi", slopes, late + slopes @ (seconds - h))
    variance = np.diag(bread @ (scores.T @ scores) @ bread)
    # a motion that does not tell leaves any instant of the row
    anywhere = h**2 / 12
    seconds = (anywhere * seconds + variance * 0.5 * h) / (anywhere + variance)
    deviations = np.sqrt(variance * anywhere / (anywhere + variance))
    return {a: Arrival(float(x), float(s)) for a, x, s in zip(drives, seconds, deviations, strict=True)}
