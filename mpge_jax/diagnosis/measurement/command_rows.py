"""Logs whose rows hold the command of the row before: the motion follows commands before they were sent, which no delay
that a model lacks explains."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.whitening import LATE, Whitener, nuisances, robust_loss, whitener
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio
from mpge_jax.diagnosis.recordings.rows.late_rows import commands_moved, rows_after
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
WINDOWS, FEWEST, ITERATIONS = 60, 4, 4


def with_earlier_commands(p: Prepared) -> Prepared:
    """The same with every command on the row before, where it was given."""
    return p.mapped(lambda s: with_commands_moved(s, 1, p.measured))


def with_commands_moved(s: Source, by: int | Array, measured: Array) -> Source:
    """The same with the commands of each row `by` ([T]) rows earlier, but of actuators whose force was measured [nu]:
    it drives them, and what their commands did was told before."""
    command = s.command.copy()
    command[:, ~measured] = s.command[rows_after(s.recording, by)][:, ~measured]
    return s.rebuilt(command=command, recording=commands_moved(s.recording, by, ~measured))


def rows_are_late(p: Prepared, f: Fitted) -> bool:
    """Whether recordings that `f` was not fitted to are predicted better, beyond doubt, with commands of a row earlier,
    its parameters fitted anew either way."""
    if p.measured.all():
        return False
    both = p, with_earlier_commands(p)
    train, held = ([windows_of(q, part) for q in both] for part in ("train", "choice"))
    if min(w.count for w in (*train, *held)) < FEWEST:
        return False
    now, then = (fitted_anew(p, f, w) for w in train)
    white = that_sees_when(p, then, held[1])
    before, after = (
        robust_loss(evaluate(p.sim, [g], w, white)[0].x) for g, w in zip((now, then), held, strict=True)
    )
    return beyond_doubt(log_ratio(before - after))


def windows_of(p: Prepared, part: Part) -> Windows:
    """Those in which it is asked where commands belong."""
    return p.windows(part, p.config.decide_s, WINDOWS, seed=31)


def fitted_anew(p: Prepared, f: Fitted, w: Windows) -> Fitted:
    """`f` with its parameters fitted to windows."""
    return fit(p.sim, [f], w, that_sees_when(p, f, w), iterations=ITERATIONS)[0] if f.theta.size else f


def that_sees_when(p: Prepared, f: Fitted, w: Windows) -> Whitener:
    """Sees past what is no physics, but for the moment of the commands: that is what is asked."""
    h, theta = f.hypothesis, f.theta
    other = {kind: x for kind, x in nuisances(p.sim, h, theta, w).items() if kind != LATE}
    return whitener(p.sim, h, theta, w, p.noise, other)
