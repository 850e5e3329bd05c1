"""Screening: one linearised step for every effect at every place, checked by simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.fit import Fitted, _Problem, _proposals, prior_loss
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.simulate import Run, Simulator
from mpge_jax.diagnosis.whiten import Whitener, robust_loss
from mpge_jax.diagnosis.windows import Windows

Array = np.ndarray


def screen(sim: Simulator, base: Fitted, terms: list[Term], w: Windows, white: Whitener) -> list[Fitted]:
    """Best quick fit of `base` plus each term, lowest loss first.

    Every start of every term is linearised once, with the base's parameters free, and two step lengths are
    simulated. The base's own Jacobian is shared by all.
    """
    ctx = sim.ctx
    own = _base_jacobian(sim, base, w, white)
    before = base.hypothesis.split(ctx, base.theta)
    problems: list[tuple[Term, _Problem]] = []
    runs: list[Run] = []
    for term in terms:
        hypothesis = base.hypothesis.with_term(term)
        params = hypothesis.params(ctx)
        for start in term.effect.starts(ctx, term.place):
            theta = hypothesis.gather(ctx, {**before, term: start})
            centre = theta.copy()
            p = _Problem(Fitted(hypothesis, theta, centre), params)
            problems.append((term, p))
            runs.append(Run(hypothesis, theta))
            part = hypothesis.slices(ctx)[hypothesis.terms.index(term)]
            steps = p.steps()
            for i in range(part.start, part.stop):
                moved = theta.copy()
                moved[i] += steps[i]
                runs.append(Run(hypothesis, moved))
    flat = _whitened(sim, runs, w, white)
    k = 0
    trials: list[tuple[int, Array]] = []
    for index, (term, p) in enumerate(problems):
        hypothesis = p.fit.hypothesis
        slices = dict(zip(hypothesis.terms, hypothesis.slices(ctx), strict=True))
        part, steps = slices[term], p.steps()
        p.whitened = flat[k]
        jacobian = np.zeros((len(p.params), *flat[k].shape), dtype=np.float32)
        for other, columns in own.items():
            jacobian[slices[other]] = columns
        n = part.stop - part.start
        jacobian[part] = (flat[k + 1 : k + 1 + n] - flat[k]) / steps[part, None, None]
        k += 1 + n
        p.jacobian = jacobian
        x = white.excess(p.whitened)
        loss = float(robust_loss(x).mean())
        p.fit = replace(p.fit, x=x, loss=loss)
        if p.params:
            trials += [(index, t) for t in _proposals(p, w)]
        p.jacobian = np.zeros((0, 0))
    outcome = _whitened(sim, [Run(problems[i][1].fit.hypothesis, t) for i, t in trials], w, white)
    for (i, theta), r in zip(trials, outcome, strict=True):
        p = problems[i][1]
        x = white.excess(r)
        loss = float(robust_loss(x).mean()) + prior_loss(p.params, theta, p.fit.centre, w.count)
        if loss < p.fit.loss:
            p.fit = replace(p.fit, theta=theta, loss=loss, x=x)
    best: dict[Term, Fitted] = {}
    for term, p in problems:
        if term not in best or p.fit.loss < best[term].loss:
            best[term] = p.fit
    return sorted(best.values(), key=lambda f: f.loss)


def _whitened(sim: Simulator, runs: list[Run], w: Windows, white: Whitener) -> Array:
    """Whitened residuals [R, W, M] in single precision, made in pieces to save memory."""
    out = np.empty((len(runs), w.count, white.seen.shape[1]), dtype=np.float32)
    for a in range(0, len(runs), 64):
        out[a : a + 64] = white(sim.residuals(runs[a : a + 64], w))
    return out


def _base_jacobian(sim: Simulator, base: Fitted, w: Windows, white: Whitener) -> dict[Term, Array]:
    if not base.theta.size:
        return {}
    p = _Problem(base, base.hypothesis.params(sim.ctx))
    steps = p.steps()
    runs = [Run(base.hypothesis, base.theta)]
    for i, h in enumerate(steps):
        moved = base.theta.copy()
        moved[i] += h
        runs.append(Run(base.hypothesis, moved))
    flat = _whitened(sim, runs, w, white)
    columns = (flat[1:] - flat[0]) / steps[:, None, None]
    return {
        t: columns[s] for t, s in zip(base.hypothesis.terms, base.hypothesis.slices(sim.ctx), strict=True)
    }
