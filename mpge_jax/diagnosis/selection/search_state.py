"""What a search works on: windows, candidates, whitening and scores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mpge_jax.diagnosis.dataset.informative_windows import screen_windows
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import Slopes, evaluate
from mpge_jax.diagnosis.estimation.screening import screen
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss, whitener_beside
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.rigid_equivalence import one_of_each
from mpge_jax.diagnosis.evidence.scored import Reached, Scored
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
MANY = 5
"""Terms beyond which a further one competes with fewer others: the cost of a fit grows with the square of the terms,
and little is left for them to explain."""
WORK = 1.2e8
"""Work of the simulator (about a minute of one core) after which that holds from two terms on."""


@dataclass
class Search:
    """Everything that the selection needs.

    Attributes:
        train, held: windows of a `length` (s). terms: candidates. say: progress callback. keep: called after every
        accepted fit, so that an interrupted search can go on. resume: where to go on. typical: how many of the training
        windows, the first ones, were drawn at random; the others were chosen because the nominal model misses most
        there.
        looked: whether all joints were looked at together (`all_joints.everywhere`), which is done once, and again
            beside one more effect that explained as much.
        by_forces: what the forces of drives say is missing (`missing_by_forces`), where they are known.
        floor: what a hypothesis would leave if it were true, by simulation; needed where noise enters otherwise than
        through start and measurements (measured forces).
    """

    sim: Simulator
    noise: Noise
    train: Windows
    held: Windows
    length: float
    terms: list[Term]
    seed: int = 0
    say: Callable[[str], None] = lambda _text: None
    max_terms: int = 6
    log: list[str] = field(default_factory=list)
    keep: Callable[[Reached], None] = lambda _reached: None
    resume: Reached = field(default_factory=Reached)
    typical: int | None = None
    looked: bool = False
    by_forces: Callable[[], Fitted | None] | None = None
    floor: Callable[[Fitted], Floor] | None = None

    def whiten(self, around: Fitted, temper: bool = True) -> tuple[Whitener, Whitener]:
        """Whiteners of training and held-out windows around a fit, in the same units."""
        train = self.whiten_one(around, self.train, temper)
        return train, self.whiten_one(around, self.held, train.factor)

    def whiten_one(self, around: Fitted, w: Windows, temper: bool | float = True) -> Whitener:
        return whitener_beside(self.sim, around.hypothesis, around.theta, w, self.noise, temper)

    def score(self, fits: list[Fitted], whites: tuple[Whitener, Whitener]) -> list[Scored]:
        factor, out = max(white.factor for white in whites), []
        train, held = self._losses(fits, self.train, whites[0]), self._losses(fits, self.held, whites[1])
        for f, (a, a_each), (b, b_each) in zip(fits, train, held, strict=True):
            tier = sum(t.effect.tier for t in f.hypothesis.terms)
            each = np.concatenate([a_each, b_each])
            ctx = self.sim.ctx
            out.append(Scored(f, a, b, f.directions(ctx), tier, factor, each, f.unlikely(ctx)))
        return out

    def _losses(self, fits: list[Fitted], w: Windows, white: Whitener) -> list[tuple[Array, Array]]:
        """Of every fit: losses of windows [W], and of each joint by itself [W, joints]."""
        m, out = self.sim.model, []
        # the degrees of freedom of a free body move together
        first = np.flatnonzero(np.diff(m.dof_jntid, prepend=-1))
        counts = np.diff(np.append(first, m.nv))
        for residual in self.sim.residuals([Run(f.hypothesis, f.theta) for f in fits], w):
            flat = white(residual)
            joints = np.add.reduceat(white.by_dof(flat, m.nv), first, axis=1) / counts
            out.append((robust_loss(white.excess(flat)), robust_loss(joints)))
        return out

    def sample(self, base: Fitted, white: Whitener) -> tuple[Windows, Whitener]:
        """A sample of the training windows for quick fits on top of a fit, with a whitener of all of them for it."""
        # by depth, so that a resumed search draws the same windows
        rng = np.random.default_rng([self.seed, len(base.hypothesis.terms)])
        # by the base's own whitening: what was simulated to find an effect is not simulated again for its rivals
        own = self.whiten_one(base, self.train)
        index = screen_windows(evaluate(self.sim, [base], self.train, own)[0].x, rng)
        return self.train.take(index), white.take(index)

    def screened(
        self, base: Fitted, sample: tuple[Windows, Whitener], terms: list[Term], slopes: Slopes | None = None
    ) -> list[Fitted]:
        """Quick fits on a sample of the training windows, best first."""
        return one_of_each(self.sim.ctx, screen(self.sim, base, terms, *sample, slopes))

    def brief(self, hypothesis: Hypothesis) -> bool:
        """Whether fewer alternatives are looked at: beside many terms, or beside two after long work."""
        count = len(hypothesis.terms)
        return count > MANY or (count > 1 and self.sim.work > WORK)
