"""Fit hypotheses to windows: Levenberg-Marquardt with all hypotheses and parameters in one batch."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.context import Param
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import finish, recordings_differ, widened
from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_loss, prior_widths
from mpge_jax.diagnosis.estimation.parameter_steps import (
    Problem,
    beyond,
    corrected,
    promise,
    proposals,
    too_slow,
    without_slopes,
)
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
Slopes = Mapping[Term, Array]
LONGER, LONGEST = 10.0, 100.0
"""Growth, and the most of it, of the differences of which slopes are told in machines with contacts where no step along
them is better: over short ones a single impact may hold them fast."""
LEAST = 0.1
"""Loss whose share is no gain where less is left."""
NEGLIGIBLE = 0.02
"""Share of what is no gain that is not worth a simulation."""


def evaluate(sim: Simulator, fits: list[Fitted], w: Windows, white: Whitener) -> list[Fitted]:
    """Losses and relative chi^2 of fits on windows."""
    res = sim.residuals([Run(f.hypothesis, f.theta) for f in fits], w)
    out = []
    for f, r in zip(fits, res, strict=True):
        x = white.excess(white(r))
        out.append(replace(f, x=x, loss=float(robust_loss(x).mean())))
    return out


def fit(
    sim: Simulator,
    starts: list[Fitted],
    w: Windows,
    white: Whitener,
    iterations: int = 8,
    tolerance: float = 1e-3,
    stride: float = 1.0,
    slopes: Slopes | None = None,
    anew: bool = True,
    still: Collection[Term] = (),
    goal: float = np.inf,
) -> list[Fitted]:
    """Fit every start; returns them in order, with losses, information and covariances on `w`.

    Where cheaper steps show what a change does, a fit goes on by those until they promise no more; then the model's own
    steps tell whether that is true. Where predictions are smooth, slopes are followed by secants, and simulated anew
    where these lead nowhere and in the end.

    Args:
        tolerance: share of the loss (of a tenth at least) that is no gain. stride: length of finite differences, in
            usual ones. slopes: of terms that the starts share, told near them: the fit begins with these. anew: slopes
            are simulated once more in the end; else information and covariances are those of the secants. still: terms
        whose parameters stay as they are. goal: loss above which a fit is of no use: what would not get there at its
        pace is given up.
    """
    problems = [
        Problem(f, f.hypothesis.params(sim.ctx), _of_terms(sim, f, still), stride=stride) for f in starts
    ]
    _verify(sim, problems, w, white, tolerance)
    _linearise(sim, problems, w, white, slopes)
    for left in reversed(range(iterations)):
        active = [p for p in problems if not p.done and p.params]
        if not active:
            break
        for p in active:
            p.losses.append(p.fit.loss)
        _advance(sim, active, w, white, tolerance, stride)
        ended = [p for p in active if p.done]
        _verify(sim, ended, w, white, tolerance)
        _linearise(sim, [p for p in ended if anew or not p.done], w, white)
        for p in active:
            p.done |= too_slow([*p.losses, p.fit.loss], left, goal)
    rest = [p for p in problems if not p.done]
    _verify(sim, rest, w, white, tolerance)
    if anew:
        _linearise(sim, rest, w, white)
    longer = [p for p in problems if p.stride != stride]
    for p in longer:
        p.stride = stride
    _linearise(sim, longer, w, white)
    return [finish(p) for p in problems]


def _advance(
    sim: Simulator, active: list[Problem], w: Windows, white: Whitener, tolerance: float, stride: float
) -> None:
    """One step of every problem."""
    ctx = sim.ctx
    trials: list[tuple[Problem, Array]] = []
    further: list[tuple[Problem, Array]] = []
    for p in active:
        steps, detours = proposals(p, ctx), without_slopes(p, ctx)
        p.smooth = not ctx.contacts and not detours
        if not p.smooth:
            steps += [x for t in steps[:1] for x in beyond(p, t, ctx)]
            trials += [(p, t) for t in steps]
            # many, each with its run-up: at first, and then where slopes lead nowhere
            (further if p.detoured else trials).extend((p, t) for t in detours)
            p.detoured = True
            continue
        least = tolerance * max(p.fit.loss, LEAST)
        # a full step may promise harm: losses are robust, and more so where windows are missed by much
        gains = (p.fit.loss - promise(p, t, w, white) for t in steps)
        promised = next((gain for gain in gains if gain > -least), 0.0)
        p.last = promised < least
        p.done = promised < NEGLIGIBLE * least
        if not p.done:
            trials += [(p, t) for t in steps[:1]]
            further += [(p, t) for t in steps[1:]]
    tried = _tried(sim, trials, w, white)
    better = _better(tried)
    second = [(p, t) for p, t in further if id(p) not in better]
    for p, found, flat in tried:
        if p.smooth and id(p) not in better:
            second += [(p, t) for t in corrected(p, found.theta, flat)]
    better |= _better(_tried(sim, second, w, white))
    anew = []
    for p in (p for p in active if not p.done):
        if id(p) in better:
            gain = p.fit.loss - better[id(p)][0].loss
            p.damping = max(p.damping * 0.2, 1e-6)
            p.small = p.small + 1 if gain < tolerance * max(p.fit.loss - gain, LEAST) else 0
            p.done = p.last if p.smooth else p.small > 1
            _move(p, *better[id(p)])
            anew += [] if p.smooth else [p]
        elif p.secant:
            anew.append(p)
        else:
            p.small += 1
            p.done = p.small > 2
            if ctx.contacts and not p.done:
                p.stride = min(LONGER * p.stride, LONGEST * stride)
                anew.append(p)
            else:
                p.damping *= 30
    _linearise(sim, anew, w, white)


def _tried(
    sim: Simulator, trials: list[tuple[Problem, Array]], w: Windows, white: Whitener
) -> list[tuple[Problem, Fitted, Array]]:
    """The problems' fits at other parameters, with whitened residuals [W, M] there; not where none moves (at a bound):
    a loss by cheaper steps may be another one, which is no gain."""
    trials = [(p, t) for p, t in trials if not np.array_equal(t, p.fit.theta)]
    runs = [Run(p.fit.hypothesis, t) for p, t in trials]
    told = _told(sim, runs, [p.exactly for p, _ in trials], w)
    out = []
    for (p, t), r in zip(trials, told, strict=True):
        flat = white(r + p.offset if p.offset.size else r)
        out.append((p, _judged(p, t, flat, w, white), flat))
    return out


def _told(sim: Simulator, runs: list[Run], exactly: list[bool], w: Windows) -> Array:
    """Residuals of runs, by cheaper steps where these show what a change does and the run is not told `exactly`."""
    return sim.cheaply(runs, w, np.array(exactly, dtype=bool)) if sim.costly(w) else sim.residuals(runs, w)


def _better(tried: list[tuple[Problem, Fitted, Array]]) -> dict[int, tuple[Fitted, Array]]:
    """By a problem's `id`, the best of its trials, where it is better."""
    out: dict[int, tuple[Fitted, Array]] = {}
    for p, found, flat in tried:
        if found.loss < out.get(id(p), (p.fit,))[0].loss:
            out[id(p)] = found, flat
    return out


def _judged(p: Problem, theta: Array, flat: Array, w: Windows, white: Whitener) -> Fitted:
    """The problem's fit at other parameters, with its loss, from the whitened residuals there."""
    x = white.excess(flat)
    loss = float(robust_loss(x).mean()) + prior_loss(p.params, theta, p.fit.centre, *flat.shape)
    return replace(p.fit, theta=theta, loss=loss, x=x)


def _move(p: Problem, to: Fitted, flat: Array) -> None:
    """Go there; the slopes change as little as what was seen on the way demands (Broyden)."""
    widths = prior_widths(p.params)
    step = (to.theta - p.fit.theta) / widths
    missed = flat - p.whitened - p.foreseen(to.theta)
    p.jacobian = p.jacobian + (step / (step @ step) / widths)[:, None, None] * missed
    p.fit, p.whitened, p.secant = to, flat, True


def _verify(sim: Simulator, problems: list[Problem], w: Windows, white: Whitener, tolerance: float) -> None:
    """Losses by the model's own steps where problems stand, if cheaper ones told them. Where these led one astray, it
    goes on by the model's own from where those told it last; where they promised something else, it goes on."""
    if not sim.costly(w):
        return
    problems = [p for p in problems if not p.exactly]
    exact = sim.residuals([Run(p.fit.hypothesis, p.fit.theta) for p in problems], w)
    for p, r in zip(problems, exact, strict=True):
        found = _judged(p, p.fit.theta, white(r), w, white)
        if p.verified is not None and found.loss >= p.verified.loss:
            if not np.array_equal(found.theta, p.verified.theta):
                p.exactly, p.done, p.last, p.damping = True, False, False, 1e-3
            p.fit = p.verified
            continue
        p.done = p.done and abs(found.loss - p.fit.loss) < tolerance * max(found.loss, LEAST)
        p.fit = p.verified = found
        p.exact = r


def _linearise(
    sim: Simulator, problems: list[Problem], w: Windows, white: Whitener, known: Slopes | None = None
) -> None:
    """Residuals and Jacobians [p, W, M] at the present parameters, all in one batch; of terms whose slopes are `known`
    near these, those."""
    runs: list[Run] = []
    exactly: list[bool] = []
    layout: list[tuple[int, Array, dict[int, Array]]] = []
    for p in problems:
        steps, told = p.steps(), _of_parameters(p, sim, known or {})
        layout.append((len(runs), steps, told))
        runs.append(Run(p.fit.hypothesis, p.fit.theta))
        for i in _asked(p, told):
            theta = p.fit.theta.copy()
            theta[i] += steps[i]
            runs.append(Run(p.fit.hypothesis, theta))
        exactly += [p.exactly] * (len(runs) - len(exactly))
    if not runs:
        return
    costly, res = sim.costly(w), _told(sim, runs, exactly, w)
    for p, (first, steps, told) in zip(problems, layout, strict=True):
        own = _asked(p, told)
        here = res[first : first + 1 + len(own)]
        if costly and p.verified is p.fit:
            p.offset = p.exact - here[0]
        if p.offset.size:
            here = here + p.offset
        flat = white(here)
        p.whitened, p.secant = flat[0], bool(told)
        p.jacobian = np.zeros((steps.size, *flat.shape[1:]), flat.dtype)
        p.jacobian[own] = (flat[1:] - flat[0]) / steps[own, None, None]
        for i, column in told.items():
            p.jacobian[i] = column
        p.fit = _judged(p, p.fit.theta, flat[0], w, white)


def _asked(p: Problem, told: dict[int, Array]) -> list[int]:
    """Parameters whose slopes are to be simulated."""
    return [i for i in np.flatnonzero(p.free).tolist() if i not in told]


def _of_terms(sim: Simulator, f: Fitted, terms: Collection[Term]) -> Array:
    """[p] which parameters are those of some terms; empty where there are none of these."""
    each = [np.full(len(t.params(sim.ctx)), t in terms) for t in f.hypothesis.terms] if terms else []
    return np.concatenate(each) if each else np.zeros(0, bool)


def _of_parameters(p: Problem, sim: Simulator, known: Slopes) -> dict[int, Array]:
    """Known slopes [W, M] by the index of the parameter."""
    h = p.fit.hypothesis
    parts = zip(h.terms, h.slices(sim.ctx), strict=True)
    return {
        i: known[t][i - part.start] for t, part in parts if t in known for i in range(part.start, part.stop)
    }


def slopes_of(sim: Simulator, f: Fitted, w: Windows, white: Whitener) -> Slopes:
    """Slopes [p, W, M] of the whitened residuals by every term's parameters."""
    if not f.theta.size:
        return {}
    p = Problem(f, f.hypothesis.params(sim.ctx))
    _linearise(sim, [p], w, white)
    return {t: p.jacobian[k] for t, k in zip(f.hypothesis.terms, f.hypothesis.slices(sim.ctx), strict=True)}


def _standing(sim: Simulator, f: Fitted, w: Windows, white: Whitener) -> Problem:
    """A fit where it stands, with its residuals and slopes there."""
    p = Problem(f, f.hypothesis.params(sim.ctx))
    _verify(sim, [p], w, white, 0.0)
    _linearise(sim, [p], w, white)
    return p


def as_wide_as_recordings_differ(sim: Simulator, f: Fitted, w: Windows, white: Whitener) -> Fitted:
    """`f` with intervals that hold by how much single recordings say otherwise."""
    if not f.cov.size:
        return f
    p = _standing(sim, f, w, white)
    return replace(f, cov=widened(f.cov, np.sqrt(recordings_differ(p, w.source))))


def gauss_newton_shift(sim: Simulator, f: Fitted, w: Windows, white: Whitener, moved: Array) -> Array:
    """Change of theta [p] when the whitened residuals [W, M] at `f` become `moved`, to first order."""
    p = _standing(sim, f, w, white)
    j, weight = p.jacobian, p.weight
    h = np.einsum("w,pwm,qwm->pq", weight, j, j, optimize=True)
    h = h + np.diag(1.0 / prior_widths(p.params) ** 2)
    g = np.einsum("w,pwm,wm->p", weight, j, moved - p.whitened, optimize=True)
    scale = 1.0 / np.sqrt(np.diag(h))
    return -scale * (np.linalg.pinv(h * scale[:, None] * scale[None, :], hermitian=True) @ (scale * g))


def timing_error(params: list[Param], theta: Array, timestep: float) -> Array:
    """Deviation [p] of fitted times: within a timestep nobody knows when the machine samples, filters and acts."""
    within = np.minimum(timestep / np.sqrt(12), 0.1 * np.abs(theta))
    return np.where([p.unit == "s" for p in params], within, 0.0)
