"""Effects that the search found, put before recordings that it did not fit: who does not help them goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, fit_report
from mpge_jax.diagnosis.evidence.paired_gains import deviations
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.selection.search_state import Search

BEYOND = 1.0
"""Standard errors by which an effect must lower the error, in the unit that is shown."""
ITERATIONS = 4


def confirmed(p: Prepared, s: Search, f: Fitted, part: Part) -> tuple[Fitted, FitReport, list[Term]]:
    """The fit without the effects that do not make one part's recordings better predicted, over windows of the reported
    length, by more than its uncertainty; with its errors there, and those effects.

    One is taken away at a time, as others may stand in for it, and the others are fitted again. What is left must then
    predict better than the model as given, or all of it goes.
    """
    gone: list[Term] = []
    while True:
        report = fit_report(p, f, part)
        if not f.hypothesis.terms:
            return f, report, gone
        sure = {t: _sureness(p, f, report, f.hypothesis.without(t)) for t in f.hypothesis.terms}
        weakest = min(sure, key=lambda t: sure[t])
        if sure[weakest] <= BEYOND:
            gone.append(weakest)
            f = _refitted(s, f, f.hypothesis.without(weakest))
        elif _sureness(p, f, report, NOTHING.hypothesis) <= BEYOND:
            gone += f.hypothesis.terms
            f = NOTHING
        else:
            return f, report, gone


def _sureness(p: Prepared, f: Fitted, report: FitReport, less: Hypothesis) -> float:
    """Standard errors by which squared errors of windows fall with what `less` lacks, the others kept."""
    parts = f.hypothesis.split(p.ctx, f.theta)
    without = replace(f, hypothesis=less, theta=less.gather(p.ctx, parts))
    gain = errors(p.sim, without, report.windows).window ** 2 - report.after.window**2
    return deviations(gain) if gain.size > 1 else float(np.sign(gain.sum()) * np.inf)


def _refitted(s: Search, f: Fitted, h: Hypothesis) -> Fitted:
    if not h.terms:
        return NOTHING
    parts, centres = (f.hypothesis.split(s.sim.ctx, x) for x in (f.theta, f.centre))
    smaller = Fitted(h, h.gather(s.sim.ctx, parts), h.gather(s.sim.ctx, centres))
    return fit(s.sim, [smaller], s.train, s.whiten_one(smaller, s.train), iterations=ITERATIONS)[0]
