"""The decisions of a search: which candidates are fitted, which is chosen, and whether it is needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2, norm

from mpge_jax.diagnosis.calibrate import Floor
from mpge_jax.diagnosis.candidates import compatible
from mpge_jax.diagnosis.evidence import EVIDENCE, SEVERAL, deviations, stand_out, strong
from mpge_jax.diagnosis.fit import evaluate, fit
from mpge_jax.diagnosis.fitted import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.left import remainder
from mpge_jax.diagnosis.rigid import one_of_each
from mpge_jax.diagnosis.scored import Reached, Scored, clearly_worse, hopeful, misses, with_simpler
from mpge_jax.diagnosis.screen import screen
from mpge_jax.diagnosis.simulate import Run, Simulator
from mpge_jax.diagnosis.states import Noise
from mpge_jax.diagnosis.telling import screen_windows
from mpge_jax.diagnosis.whiten import Whitener, numerics, robust_loss, whitener
from mpge_jax.diagnosis.windows import Windows

Array = np.ndarray
KEEP = 7
"""Candidates that are fitted properly after screening."""
MANY, KEEP_OF_MANY = 5, 3
"""Terms beyond which a further one competes with fewer others: the cost of a fit grows with the square of the terms,
and little is left for them to explain."""
WORK = 1.2e8
"""Work of the simulator (about a minute of one core) after which that holds from two terms on."""
HOPELESS = 0.06
"""Share of the loss that a second effect must take away in screening to be looked at further."""
SIGNIFICANT = 3.0
"""Standard errors by which an effect must improve windows that it was not fitted to."""
SMALL = 0.02
"""Share of the nominal error by which a further effect must move predictions; less is detail of what is known
(friction law, timestep, integrator), which a wrong effect can imitate."""
LOUD = 1.5
"""Mean loss at one degree of freedom beyond which something may be missing there."""
QUIET, SETTLED = 1.1, 1.25
"""Mean loss of a model from which nothing is missing, as given and with effects that were found (whose law is never
exact to the noise). It leaves too little for an effect to be `needed`."""
NAMED = 4.0
"""Deviations by which a contrast must differ from its value at null."""
STEPS = 0.75
"""Timesteps that a delay or time constant lasts at least, unless it halves the loss: a semi-implicit step acts half a
step early, which another integrator or a finer timestep behind the recordings does not."""


@dataclass
class Search:
    """Everything that the selection needs.

    Attributes:
        train, held: windows. terms: candidates. say: progress callback. keep: called after every accepted fit,
        so that an interrupted search can go on. resume: where to go on. typical: how many of the training windows,
        the first ones, were drawn at random; the others were chosen because the nominal model misses most there.
        looked: whether all joints were looked at together (`dense.everywhere`), which is done once.
        floor: what a hypothesis would leave if it were true, by simulation; needed where noise enters otherwise than
        through start and measurements (measured forces).
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
    keep: Callable[[Reached], None] = lambda _reached: None
    resume: Reached = field(default_factory=Reached)
    typical: int | None = None
    looked: bool = False
    floor: Callable[[Fitted], Floor] | None = None

    def whiten(self, around: Fitted, temper: bool = True) -> tuple[Whitener, Whitener]:
        """Whiteners of training and held-out windows around a fit, in the same units."""
        train = self.whiten_one(around, self.train, temper)
        return train, self.whiten_one(around, self.held, train.factor)

    def whiten_one(self, around: Fitted, w: Windows, temper: bool | float = True) -> Whitener:
        nuisance = numerics(self.sim, around.hypothesis, around.theta, w)
        return whitener(self.sim, around.hypothesis, around.theta, w, self.noise, nuisance, temper)

    def score(self, fits: list[Fitted], whites: tuple[Whitener, Whitener]) -> list[Scored]:
        train = evaluate(self.sim, fits, self.train, whites[0])
        held = evaluate(self.sim, fits, self.held, whites[1])
        out = []
        factor = max(white.factor for white in whites)
        for f, a, b in zip(fits, train, held, strict=True):
            tier = sum(t.effect.tier for t in f.hypothesis.terms)
            directions = f.directions(self.sim.ctx)
            out.append(Scored(f, robust_loss(a.x), robust_loss(b.x), directions, tier, factor))
        return out

    def sample(self, base: Fitted, white: Whitener) -> tuple[Windows, Whitener]:
        """A sample of the training windows for quick fits, with its whitener."""
        # by depth, so that a resumed search draws the same windows
        rng = np.random.default_rng([self.seed, len(base.hypothesis.terms)])
        index = screen_windows(evaluate(self.sim, [base], self.train, white)[0].x, rng)
        return self.train.take(index), white.take(index)

    def screened(self, base: Fitted, white: Whitener, terms: list[Term]) -> list[Fitted]:
        """Quick fits on a sample of the training windows, best first."""
        return one_of_each(self.sim.ctx, screen(self.sim, base, terms, *self.sample(base, white)))

    def compete(self, base: Fitted, terms: list[Term], keep: int = KEEP) -> tuple[list[Scored], Scored]:
        """Fit the most promising `terms` on top of `base`, each judged under the winner's own whitening.

        Returns the scored candidates, best first by plain loss, and the base scored in the same way.
        """
        white = self.whiten_one(base, self.train)
        if self.at_noise(base, white):
            return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
        terms = [t for t in terms if compatible(base.hypothesis, t)]
        sample = self.sample(base, white)
        screened = one_of_each(self.sim.ctx, screen(self.sim, base, terms, *sample))
        before = evaluate(self.sim, [base], *sample)[0].loss
        if base.hypothesis.terms and (
            not screened or screened[0].loss > before - HOPELESS * min(before, 3.0)
        ):
            return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
        many = self.brief(base.hypothesis)
        keep = KEEP_OF_MANY if many else keep
        fits = hopeful(fit(self.sim, with_simpler(screened, keep), *sample, iterations=4), before)
        winner = None
        for _ in range(1 if many else 2):
            if not fits or fits[0].hypothesis == winner:
                break
            winner = fits[0].hypothesis
            white = self.whiten_one(fits[0], self.train)
            fits = fit(self.sim, with_simpler(fits, max(keep - 2, 2)), self.train, white, iterations=4)
            fits.sort(key=lambda f: f.loss)
        if not fits:
            return [], Scored(base, np.zeros(0), np.zeros(0), 0, 0)
        whites = white, self.whiten_one(fits[0], self.held, white.factor)
        scored = self.score([*fits, self.freed(base, fits, white)], whites)
        ranked = sorted(scored[:-1], key=lambda s: s.losses.mean())
        return ranked, scored[-1]

    def brief(self, hypothesis: Hypothesis) -> bool:
        """Whether fewer alternatives are looked at: beside many terms, or beside two after long work."""
        count = len(hypothesis.terms)
        return count > MANY or (count > 1 and self.sim.work > WORK)

    def at_noise(self, base: Fitted, white: Whitener) -> bool:
        """Whether training (under `white`) and held-out windows show nothing but noise, and none stands out."""
        outlying = 0
        for w in (self.train, self.held):
            white = white if w is self.train else self.whiten_one(base, w)
            flat = white(self.sim.residuals([Run(base.hypothesis, base.theta)], w))[0]
            x, limit = white.excess(flat), SETTLED if base.hypothesis.terms else QUIET
            # in a large machine, what one joint lacks drowns in the mean over all
            if not base.hypothesis.terms:
                each = robust_loss(white.by_dof(flat, self.sim.model.nv)).mean(0)
                if each.max() > LOUD:
                    return self._at_floor(base)
            outlying += int(stand_out(robust_loss(x)).sum())
            # a tempered whitener, or an overestimated noise, says nothing
            little = np.median(x) < 0.5 and not white.inexact
            if white.factor != 1.0 or little or robust_loss(x).mean() > limit:
                return self._at_floor(base)
        return outlying < SEVERAL or self._at_floor(base)

    def _at_floor(self, base: Fitted) -> bool:
        """Whether `base` leaves no more than it would if it were true. Of the model as given that is asked with
        contacts alone, and where chance leaves much: there a wrong effect finds something to explain."""
        nominal = not base.hypothesis.terms
        if self.floor is None or (nominal and not self.sim.ctx.contacts):
            return False
        floor = self.floor(base)
        if nominal and floor.loss < SETTLED:
            return False
        return remainder(self, base, floor, thorough=False) is None

    def freed(self, base: Fitted, fits: list[Fitted], white: Whitener) -> Fitted:
        """`base`, or a better fit of its own terms to which a further term led out of a local minimum."""
        if not base.theta.size or self.brief(base.hypothesis):
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

    def choose(self, ranked: list[Scored], without: Hypothesis = Hypothesis()) -> Scored:  # noqa: B008
        """The simplest candidate within two standard errors of the best, of those whose new terms are `named`."""
        ranked = [s for s in ranked if self.named(s.fit, without)] or ranked
        tied = [s for s in ranked if not clearly_worse(s, ranked[0])]
        return min(tied, key=lambda s: (*s.complexity, s.losses.mean()))

    def accept(self, new: Scored, old: Scored, doubt: float = SIGNIFICANT) -> bool:
        """Whether the new terms improve held-out windows beyond doubt, and their parameters differ from null."""
        first = not old.fit.hypothesis.terms
        return (
            self.needed(new, old, doubt)
            and self.named(new.fit, old.fit.hypothesis)
            and (first or self.share(new.fit, old.fit) > SMALL)
            and (self.lasts(new.fit, old.fit.hypothesis) or bool(2.0 * new.held.mean() < old.held.mean()))
        )

    def lasts(self, f: Fitted, without: Hypothesis) -> bool:
        """Whether no added term is a mere delay, or lag, of less than a timestep."""
        ctx = self.sim.ctx
        for term, theta in f.hypothesis.split(ctx, f.theta).items():
            params, naming = term.effect.params(ctx, term.place), term.effect.naming(ctx, term.place)
            times = [theta[i] for i in naming if params[i].unit == "s"]
            if term not in without.terms and times and max(times) < STEPS * ctx.model.opt.timestep:
                return False
        return True

    def needed(self, new: Scored, old: Scored, doubt: float = SIGNIFICANT) -> bool:
        """Whether held-out windows are predicted better with the terms that `new` has and `old` lacks."""
        gain, total = old.held - new.held, old.losses - new.losses
        # the first effect must not be an accident; beside one, held-out windows are dominated by what is still missing
        first = not old.fit.hypothesis.terms
        beyond = deviations(gain) > (doubt if first else 0.6 * doubt) and deviations(total) > doubt
        if misses(old, new):
            return True
        relevant = total.mean() > 0.05 * min(1.0, old.losses.mean())
        return bool(relevant and ((beyond and gain.sum() > EVIDENCE) or strong(gain, total)))

    def share(self, new: Fitted, old: Fitted) -> float:
        """How far `new` moves the predictions of `old`, over the nominal model's error, at the joint where most."""
        nv = self.sim.model.nv
        fits = (NOTHING, old, new)
        res = self.sim.residuals([Run(f.hypothesis, f.theta) for f in fits], self.held)[..., :nv]
        seen = np.isfinite(res).all(0)
        nominal, before, after = np.where(seen, np.clip(res, -1e3, 1e3), 0.0)
        change = np.sqrt(((after - before) ** 2).sum((0, 1)))
        error = np.sqrt((nominal**2).sum((0, 1)))
        return float(np.max(change / np.maximum(error, 1e-300), initial=0.0, where=error > 0))

    def named(self, f: Fitted, without: Hypothesis = Hypothesis()) -> bool:  # noqa: B008
        """Whether every added term differs clearly from what its effect vanishes in."""
        return all(z >= NAMED for term, z in self.strength(f).items() if term not in without.terms)

    def strength(self, f: Fitted) -> dict[Term, float]:
        """By how many deviations each term's `contrasts`, together or the best by itself, differ from null."""
        ctx, out = self.sim.ctx, {}
        for term, part in zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True):
            contrasts = term.effect.contrasts(ctx, term.place)
            if not len(contrasts) or not f.cov.size:
                out[term] = np.inf
                continue
            delta = contrasts @ (f.theta[part] - term.effect.null(ctx, term.place))
            cov = contrasts @ f.cov[part, part] @ contrasts.T
            deviation = np.sqrt(np.maximum(np.diag(cov), 1e-300))
            # of a wave, amplitude and phase may be known where neither of its two parts is
            z = delta / deviation
            correlation = cov / np.outer(deviation, deviation)
            together = z @ np.linalg.pinv(correlation, rcond=1e-8, hermitian=True) @ z
            # as unlikely as that many deviations of one number
            alike = norm.isf(0.5 * chi2.sf(max(together, 0.0), len(z)))
            out[term] = max(float(np.abs(z).max()), float(alike))
        return out
