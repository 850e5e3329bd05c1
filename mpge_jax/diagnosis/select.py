"""Choose the effects: screening, proper fits, held-out comparison with parsimony, additions, exchanges, removals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from mpge_jax.diagnosis.candidates import compatible
from mpge_jax.diagnosis.fit import Fitted, evaluate, fit, gauss_newton_shift
from mpge_jax.diagnosis.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.screen import screen
from mpge_jax.diagnosis.simulate import Run, Simulator
from mpge_jax.diagnosis.states import Noise
from mpge_jax.diagnosis.whiten import Whitener, numerics, robust_loss, whitener
from mpge_jax.diagnosis.windows import Windows

Array = np.ndarray
KEEP = 7
"""Candidates that are fitted properly after screening."""
SCREEN_WINDOWS = 14
HOPELESS = 0.06
"""Share of the loss that a second effect must take away in screening to be looked at further."""
FAR = 2.5
"""Loss above which the second effect is looked for beside several first ones."""
TIE = 0.03
"""Differences of relative loss below this are ties, whatever their standard error."""
SIGNIFICANT = 3.0
"""Standard errors by which an effect must improve windows that it was not fitted to."""
SMALL = 0.02
"""Share of the nominal error by which a further effect must move predictions; less is detail of what is known
(friction law, timestep, integrator), which a wrong effect can imitate."""
NAMED = 4.0
"""Deviations by which a naming parameter must differ from its null value."""


@dataclass
class Scored:
    """A fit with its loss on every window, training windows first."""

    fit: Fitted
    train: Array
    held: Array
    directions: int
    tier: int

    @property
    def losses(self) -> Array:
        return np.concatenate([self.train, self.held])

    @property
    def complexity(self) -> tuple[float, ...]:
        return (self.directions + 0.75 * self.tier, self.fit.theta.size)


@dataclass
class Rival:
    """An alternative to one term: the losses tell by how much it is worse."""

    term: Term
    fit: Fitted
    margin: float
    error: float
    why_not: str
    tied: bool = False


@dataclass
class Search:
    """Everything that the selection needs.

    Attributes:
        train, held: windows. terms: candidates. say: progress callback. keep: called with every accepted fit,
        so that an interrupted search can go on. resume: where to go on.
    """

    sim: Simulator
    noise: Noise
    train: Windows
    held: Windows
    terms: list[Term]
    seed: int = 0
    say: Callable[[str], None] = lambda _text: None
    max_terms: int = 6
    log: list[str] = field(default_factory=list)
    keep: Callable[[Fitted], None] = lambda _fit: None
    resume: Fitted | None = None

    def nominal(self) -> Fitted:
        return Fitted(Hypothesis(), np.zeros(0), np.zeros(0))

    def whiten(self, around: Fitted, temper: bool = True) -> tuple[Whitener, Whitener]:
        """Whiteners of training and held-out windows around a fit."""
        out = []
        for w in (self.train, self.held):
            nuisance = [numerics(self.sim, around.hypothesis, around.theta, w)]
            out.append(whitener(self.sim, around.hypothesis, around.theta, w, self.noise, nuisance, temper))
        return out[0], out[1]

    def score(self, fits: list[Fitted], whites: tuple[Whitener, Whitener]) -> list[Scored]:
        train = evaluate(self.sim, fits, self.train, whites[0])
        held = evaluate(self.sim, fits, self.held, whites[1])
        out = []
        for f, a, b in zip(fits, train, held, strict=True):
            tier = sum(t.effect.tier for t in f.hypothesis.terms)
            out.append(Scored(f, robust_loss(a.x), robust_loss(b.x), f.directions(self.sim.ctx), tier))
        return out

    def screened(self, base: Fitted, white: Whitener, terms: list[Term]) -> tuple[list[Fitted], float]:
        """Quick fits on a sample of the training windows, and the base's loss there."""
        # by depth, so that a resumed search draws the same windows
        rng = np.random.default_rng([self.seed, len(base.hypothesis.terms)])
        index = screen_windows(evaluate(self.sim, [base], self.train, white)[0].x, rng)
        w, white = self.train.take(index), white.take(index)
        return screen(self.sim, base, terms, w, white), evaluate(self.sim, [base], w, white)[0].loss

    def compete(self, base: Fitted, terms: list[Term], keep: int = KEEP) -> tuple[list[Scored], Scored]:
        """Fit the most promising `terms` on top of `base`, each judged under the winner's own whitening.

        Returns the scored candidates, best first by plain loss, and the base scored in the same way.
        """
        whites = self.whiten(base)
        screened, before = self.screened(
            base, whites[0], [t for t in terms if compatible(base.hypothesis, t)]
        )
        if base.hypothesis.terms and (
            not screened or screened[0].loss > before - HOPELESS * min(before, 3.0)
        ):
            return [], self.score([base], whites)[0]
        fits = fit(self.sim, _with_simpler(screened, keep), self.train, whites[0], iterations=4)
        fits.sort(key=lambda f: f.loss)
        winner = None
        for _ in range(2):
            if not fits or fits[0].hypothesis == winner:
                break
            winner = fits[0].hypothesis
            whites = self.whiten(fits[0])
            fits = fit(self.sim, fits[: keep - 2], self.train, whites[0], iterations=4)
            fits.sort(key=lambda f: f.loss)
        scored = self.score([*fits, self.freed(base, fits, whites[0])], whites)
        ranked = sorted(scored[:-1], key=lambda s: s.losses.mean())
        return ranked, scored[-1]

    def freed(self, base: Fitted, fits: list[Fitted], white: Whitener) -> Fitted:
        """`base`, or a better fit of its own terms to which a further term led out of a local minimum."""
        if not base.theta.size:
            return base
        ctx, terms = self.sim.ctx, base.hypothesis.terms
        starts = [base]
        for f in fits[:3]:
            if set(terms) <= set(f.hypothesis.terms):
                parts = f.hypothesis.split(ctx, f.theta)
                starts.append(replace(base, theta=base.hypothesis.gather(ctx, parts)))
        again = fit(self.sim, starts, self.train, white, iterations=4)
        best = min(again[1:], key=lambda f: f.loss, default=base)
        return best if best.loss < 0.5 * again[0].loss else base

    def choose(self, ranked: list[Scored]) -> Scored:
        """The simplest candidate within two standard errors of the best."""
        best = ranked[0]
        tied = [s for s in ranked if not clearly_worse(s, best)]
        return min(tied, key=lambda s: (*s.complexity, s.losses.mean()))

    def accept(self, new: Scored, old: Scored, doubt: float = SIGNIFICANT) -> bool:
        """Whether the new terms improve held-out windows beyond doubt, and their parameters differ from null."""
        gain = old.held - new.held
        se = standard_error(gain)
        total = old.losses - new.losses
        # the first effect must not be an accident; beside one, held-out windows are dominated by what is still missing
        first = not old.fit.hypothesis.terms
        enough = gain.mean() > (
            doubt if first else 0.6 * doubt
        ) * se and total.mean() > doubt * standard_error(total)
        relevant = total.mean() > 0.05 * min(1.0, old.losses.mean())
        named = self.named(new.fit, old.fit.hypothesis)
        return bool(enough and relevant and named and (first or self.share(new.fit, old.fit) > SMALL))

    def share(self, new: Fitted, old: Fitted) -> float:
        """How far `new` moves the predictions of `old`, over the nominal model's error, at the joint where most."""
        nv = self.sim.model.nv
        fits = (self.nominal(), old, new)
        res = self.sim.residuals([Run(f.hypothesis, f.theta) for f in fits], self.held)[..., :nv]
        seen = np.isfinite(res).all(0)
        nominal, before, after = np.where(seen, np.clip(res, -1e3, 1e3), 0.0)
        change = np.sqrt(((after - before) ** 2).sum((0, 1)))
        error = np.sqrt((nominal**2).sum((0, 1)))
        return float(np.max(change / np.maximum(error, 1e-300), initial=0.0, where=error > 0))

    def named(self, f: Fitted, without: Hypothesis = Hypothesis()) -> bool:  # noqa: B008
        """Whether every added term has a naming parameter that differs clearly from its null value."""
        ctx = self.sim.ctx
        for term, part in zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True):
            if term in without.terms:
                continue
            naming = term.effect.naming(ctx, term.place)
            if not naming or not f.cov.size:
                continue
            null = term.effect.null(ctx, term.place)
            cov = f.cov[part, part]
            delta = f.theta[part] - null
            z = np.abs(delta[naming]) / np.sqrt(np.maximum(np.diag(cov)[naming], 1e-300))
            if z.max() < NAMED:
                return False
        return True


def screen_windows(x: Array, rng: np.random.Generator) -> Array:
    """Windows for screening: a third of them where the base misses most (what acts now and then must be among
    them), the others at random. x: [W] misfit of the base."""
    count = min(SCREEN_WINDOWS, x.size)
    worst = np.argsort(-x)[: count // 3]
    others = rng.permutation(np.setdiff1d(np.arange(x.size), worst))
    return np.sort(np.concatenate([worst, others[: count - worst.size]]))


def _with_simpler(screened: list[Fitted], keep: int) -> list[Fitted]:
    """The best `keep`, and the plain form of every elaborate friction among them."""
    top = screened[:keep]
    chosen = {f.hypothesis for f in top}
    elaborate = ("stribeck_friction", "load_dependent_friction", "asymmetric_friction")
    plain = ("coulomb_friction", "viscous_damping")
    places = {t.place for f in top for t in f.hypothesis.terms if t.id in elaborate}
    for f in screened[keep:]:
        if f.hypothesis not in chosen and any(
            t.id in plain and t.place in places for t in f.hypothesis.terms
        ):
            top.append(f)
    return top


def standard_error(difference: Array) -> float:
    n = difference.size
    return float(difference.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")


def clearly_worse(a: Scored, best: Scored) -> bool:
    """Whether `a` loses to the best by more than two standard errors (paired by window) and more than a tie."""
    d = a.losses - best.losses
    return bool(d.mean() > max(2.0 * standard_error(d), TIE))


def search(s: Search) -> tuple[Fitted, list[Scored]]:
    """Forward selection with a small beam in the first two rounds; returns the fit and the last round's field."""
    current = s.resume or s.nominal()
    last: list[Scored] = []
    first_round: list[Scored] = []
    while len(current.hypothesis.terms) < s.max_terms:
        depth = len(current.hypothesis.terms)
        s.say(f"looking for effect {depth + 1}")
        ranked, base = s.compete(current, s.terms)
        current = base.fit
        if not ranked:
            break
        chosen = s.choose(ranked)
        s.log.append(
            f"round {depth + 1}: base {base.losses.mean():.3f}; "
            + "; ".join(f"{r.fit.hypothesis} {r.losses.mean():.3f}/{r.directions}" for r in ranked[:6])
            + f" -> {chosen.fit.hypothesis}"
        )
        if not s.accept(chosen, base):
            if not last:
                last = ranked
            break
        last = ranked
        if depth == 0:
            first_round = ranked
            alternatives = _beam(ranked, chosen)
            if chosen.losses.mean() > FAR and len(alternatives) > 1:
                current, last = _second_round(s, chosen, alternatives)
                s.keep(current)
                continue
        current = chosen.fit
        s.keep(current)
    return prune(s, current), last or first_round


def _beam(ranked: list[Scored], chosen: Scored, width: int = 3) -> list[Scored]:
    """The chosen fit and the best ones of another kind or at another place."""

    def kind(s: Scored) -> tuple[str, object]:
        term = s.fit.hypothesis.terms[-1]
        return ("friction" if "friction" in term.id or "damping" in term.id else term.id, term.place)

    out, kinds = [chosen], {kind(chosen)}
    for r in ranked:
        # a first effect that explains next to nothing is no start for a pair
        if kind(r) not in kinds and len(out) < width and r.losses.mean() < 3.0 * chosen.losses.mean():
            out.append(r)
            kinds.add(kind(r))
    return out


def _second_round(s: Search, chosen: Scored, beam: list[Scored]) -> tuple[Fitted, list[Scored]]:
    """Second effects on top of each of the best first ones; the best pair if a pair is needed, else the first."""
    pairs: dict[Hypothesis, Fitted] = {}
    for b in beam:
        s.say(f"looking for effect 2 beside {b.fit.hypothesis}")
        white = s.whiten(b.fit)[0]
        screened, _ = s.screened(b.fit, white, [t for t in s.terms if compatible(b.fit.hypothesis, t)])
        for f in _with_simpler(screened, 4):
            old = pairs.get(f.hypothesis)
            if old is None or f.loss < old.loss:
                pairs[f.hypothesis] = f
    if not pairs:
        return chosen.fit, [chosen]
    fits = sorted(pairs.values(), key=lambda f: f.loss)[:8]
    # under one whitening, so that pairs can be compared
    whites = s.whiten(fits[0])
    fits = sorted(fit(s.sim, fits, s.train, whites[0], iterations=4), key=lambda f: f.loss)[:5]
    whites = s.whiten(fits[0])
    fits = fit(s.sim, fits, s.train, whites[0], iterations=4)
    scored = s.score([*fits, chosen.fit], whites)
    ranked = sorted(scored[:-1], key=lambda r: r.losses.mean())
    winner = s.choose(ranked)
    s.log.append(
        f"pairs: single {scored[-1].losses.mean():.3f}; "
        + "; ".join(f"{r.fit.hypothesis} {r.losses.mean():.3f}/{r.directions}" for r in ranked[:5])
        + f" -> {winner.fit.hypothesis}"
    )
    if not s.accept(winner, scored[-1]):
        return chosen.fit, [chosen]
    return winner.fit, ranked


def prune(s: Search, current: Fitted) -> Fitted:
    """Remove, one at a time, effects without which held-out windows are predicted as well."""
    while len(current.hypothesis.terms) > 1:
        whites = s.whiten(current)
        current = fit(s.sim, [current], s.train, whites[0], iterations=3)[0]
        smaller = []
        parts = current.hypothesis.split(s.sim.ctx, current.theta)
        centres = current.hypothesis.split(s.sim.ctx, current.centre)
        for t in current.hypothesis.terms:
            h = current.hypothesis.without(t)
            smaller.append(Fitted(h, h.gather(s.sim.ctx, parts), h.gather(s.sim.ctx, centres)))
        smaller = fit(s.sim, smaller, s.train, whites[0], iterations=4)
        scored = s.score([*smaller, current], whites)
        weakest = min(scored[:-1], key=lambda r: r.losses.mean())
        # what was once accepted needs less to stay
        if s.accept(scored[-1], weakest, doubt=0.6 * SIGNIFICANT):
            return current
        s.log.append(f"removed: {current.hypothesis} -> {weakest.fit.hypothesis}")
        current = weakest.fit
    return current


def final_fit(s: Search, current: Fitted) -> tuple[Fitted, tuple[Whitener, Whitener]]:
    """Refit under the hypothesis's own whitening until it stands still."""
    for _ in range(2):
        whites = s.whiten(current)
        if not current.theta.size:
            break
        current = fit(s.sim, [current], s.train, whites[0], iterations=6, tolerance=1e-5)[0]
    whites = s.whiten(current)
    return with_timestep_error(s, current), whites


def with_timestep_error(s: Search, f: Fitted) -> Fitted:
    """Add to the covariance what the timestep does to the parameters: their shift when it is halved.

    A semi-implicit step acts half a timestep early, which the fit takes for physics (a delay too long by that
    much); the noise says nothing about it. The shift is one Gauss-Newton step.
    """
    if not f.theta.size or not f.cov.size:
        return f
    white = whitener(s.sim, f.hypothesis, f.theta, s.train, s.noise)
    run = [Run(f.hypothesis, f.theta)]
    moved = white(s.sim.residuals(run, s.train.refined(2))[0])
    shift = np.abs(gauss_newton_shift(s.sim, f, s.train, white, moved))
    deviation = np.sqrt(np.maximum(np.diag(f.cov), 0.0))
    widths = np.where(deviation > 0, np.sqrt(deviation**2 + shift**2) / np.maximum(deviation, 1e-300), 1.0)
    return replace(f, cov=f.cov * widths[:, None] * widths[None, :])
