"""When, between two rows, a late command reaches its drive.

Forces measured at the rows tell a delay to a whole row only: between two of them a held force changes once, and all
instants at which it may do so fit the rows alike. Which one it is moves the machine by half a row's impulse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.parameter_steps import Problem
from mpge_jax.diagnosis.estimation.whitening import robust_weight, whitener
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
WINDOWS, FEWEST = 60, 4
HALFWAY = 0.25
"""Delays fitted to forces at rows lie between the half-way point and the end of a row, as all those fit alike: by this
share of a row before the former they still belong to that row."""
MOVED = 2.0
"""Deviations by which a delay differs from another one."""


@dataclass(frozen=True)
class Arrival:
    """Delay (s) of a drive and its standard deviation."""

    delay: float
    deviation: float


def row_of(delay: float, period: float) -> tuple[float, float]:
    """The delays (s) between which one that was fitted to forces at rows may lie."""
    rows = max(int(np.ceil(delay / period - HALFWAY)) - 1, 0)
    return rows * period, (rows + 1) * period


def arriving(source: Source, delays: dict[int, float], by_law: Array | None = None) -> Source:
    """The same where commands reach their drives so late (actuator -> s): the force that each of them makes is the one
    measured at the first row after its arrival, or what the drive's law makes of it (`by_law` [nu])."""
    command, t = source.command.copy(), source.recording.time
    late = np.zeros(command.shape[1]) if source.late is None else np.array(source.late, dtype=float)
    for a, delay in delays.items():
        late[a] = delay
        if by_law is None or not by_law[a]:
            # what arrives with a row is in its force already
            first = np.searchsorted(t, t + delay - 1e-9)
            command[:, a] = source.command[np.minimum(first, t.size - 1), a]
    return source.rebuilt(command=command, late=late)


def with_arrivals(p: Prepared, when: dict[int, Arrival]) -> Prepared:
    """The same machine with forces that begin between rows."""
    delays = {a: x.delay for a, x in when.items()}
    return p.mapped(lambda s: arriving(s, delays, p.by_law))


def moved(old: dict[int, Arrival], new: dict[int, Arrival]) -> bool:
    """Whether a delay is another one than was taken for it."""
    return any(abs(new[a].delay - old[a].delay) > MOVED * new[a].deviation for a in old)


def arrivals(p: Prepared, f: Fitted, rows: dict[int, tuple[float, float]]) -> dict[int, Arrival]:
    """The delay of each drive, within its `row_of`, that fits the motion best under `f`.

    Args:
        p: the machine with forces that begin at the rows.

    The motion of a window is linear in delays of less than a row, so this is a bounded least-squares problem in
    whitened residuals, the parameters of `f` beside it. Where the motion does not tell, any instant of the row is as
    likely.
    """
    if not rows:
        return {}
    low, high = np.array(list(rows.values())).T
    middle, prior = 0.5 * (low + high), 12.0 / (high - low) ** 2
    w = p.windows("train", p.config.decide_s, WINDOWS, seed=11)
    if w.count < FEWEST:
        return {a: Arrival(x, s) for a, x, s in zip(rows, middle, prior**-0.5, strict=True)}
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise)

    def left_at(delays: Array, thetas: list[Array]) -> Array:
        at = dict(zip(rows, delays, strict=True))
        runs = [Run(f.hypothesis, theta) for theta in thetas]
        return white(p.sim.residuals(runs, w.driven_by(tuple(arriving(s, at, p.by_law) for s in w.sources))))

    # what was fitted to other delays may move with them
    steps = np.diag(Problem(f, f.hypothesis.params(p.ctx)).steps())
    late, *further = left_at(high, [f.theta, *(f.theta + steps)])
    columns = []
    for k in range(len(rows)):
        # just after a row, not with it
        early = np.where(np.arange(len(rows)) == k, low + 1e-6 * (high - low), high)
        columns.append((late - left_at(early, [f.theta])[0]) / (high[k] - low[k]))
    columns += [(x - late) / h for x, h in zip(further, np.diag(steps), strict=True)]
    slopes, free = np.stack(columns, -1), np.full(f.theta.size, np.inf)
    least, most = (np.append(x - middle, y) for x, y in ((low, -free), (high, free)))
    ridge = np.append(prior, 1e-6 / np.diag(steps) ** 2)
    start = late + slopes[..., : len(rows)] @ (middle - high)
    change = np.zeros(ridge.size)
    for _ in range(5):
        weight = robust_weight(white.excess(start + slopes @ change))
        gram = np.einsum("w,wmi,wmj->ij", weight, slopes, slopes) + np.diag(ridge)
        root = np.linalg.cholesky(gram)
        push = -np.einsum("w,wmi,wm->i", weight, slopes, start)
        change = lsq_linear(root.T, np.linalg.solve(root, push), bounds=(least, most)).x
    scores = weight[:, None] * np.einsum("wmi,wm->wi", slopes, start + slopes @ change)
    bread = np.linalg.inv(gram)
    cov = bread @ (scores.T @ scores + np.diag(ridge)) @ bread
    return {a: Arrival(float(middle[k] + change[k]), float(np.sqrt(cov[k, k]))) for k, a in enumerate(rows)}
