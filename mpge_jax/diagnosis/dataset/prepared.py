"""What a search works on: the machine, its recordings with their states and noise, and windows of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.dataset.cut_windows import MAX_SAMPLES, cut
from mpge_jax.diagnosis.dataset.starts_from_before import started_from_before
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.recordings.three_parts import PARTS, Part
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.driving.actuator_state import settling
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.force_between_rows import Law, followed
from mpge_jax.diagnosis.simulation.driving.measured_drives import follows
from mpge_jax.diagnosis.simulation.guided import led
from mpge_jax.diagnosis.simulation.windows import Windows

SPARSE = 0.2
"""Time between rows, over the length of a window, beyond which windows last whole rows."""


@dataclass
class Prepared:
    """Inputs of the search.

    Attributes:
        spec: the nominal description. model: its compiled form (mechanical side: driven by measured forces where these
        exist). train, choice, test: recordings to fit parameters to, to choose effects by, and to compute the reported
        errors on, which nothing else looks at. measured: [nu] whether an actuator's force was measured and commanded.
        known: [nu] whether that force is its law's, without the noise of its measurement (None: of none). by_law: [nu]
        whether an actuator is driven by its command, as its law explains the measured force (None: none is).
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    names: Names
    ctx: Context
    sim: Simulator
    noise: Noise
    train: tuple[Source, ...]
    choice: tuple[Source, ...]
    test: tuple[Source, ...]
    dt: float
    measured: np.ndarray
    warnings: list[str]
    config: Config
    timestep: float
    known: np.ndarray | None = None
    by_law: np.ndarray | None = None

    @property
    def by_force(self) -> np.ndarray:
        """[nu] whether an actuator is driven by the force that was measured on it."""
        return self.measured if self.by_law is None else self.measured & ~self.by_law

    @property
    def looked_at(self) -> tuple[Source, ...]:
        """What may be looked at before everything is decided: all but the test recordings."""
        return self.train + self.choice

    @property
    def sources(self) -> tuple[Source, ...]:
        return self.looked_at + self.test

    def all_to_train(self) -> Prepared:
        """The same with the recordings that chose the effects among those that their parameters are fitted to."""
        return replace(self, train=self.looked_at, choice=())

    def mapped(self, change: Callable[[Source], Source]) -> Prepared:
        """The same with every recording changed."""
        train, choice, test = (tuple(map(change, part)) for part in (self.train, self.choice, self.test))
        return replace(self, train=train, choice=choice, test=test)

    def guiding(self, *dofs: int) -> Prepared:
        """The same where some hinges or slides move as recorded: what acts there is not told, nor does it mislead what
        is told of the others. Its warnings are its own."""
        rng = np.random.default_rng([self.config.seed, *dofs])
        its = self.mapped(lambda s: led(s, self.model, self.noise, dofs, rng))
        return replace(its, sim=self.sim.guiding(*dofs), warnings=list(self.warnings))

    def windows(
        self,
        part: Part,
        duration: float,
        limit: int,
        seed: int = 0,
        samples: int = MAX_SAMPLES,
        judged: bool = False,
    ) -> Windows:
        """At most `limit` windows of at most `samples` rows, of `duration` s or shorter where recordings are.

        Those that errors are told of (`judged`), and all of test recordings, start from what was recorded before the
        rows that are compared.
        """
        parts = [
            [s.recording.duration - max(settling(s, self.model), s.spent) for s in getattr(self, k)]
            for k in PARTS
        ]
        lengths = [x for each in parts for x in each]
        if self.ctx.period > SPARSE * duration:
            duration = float(np.ceil(duration / self.ctx.period - 1e-6)) * self.ctx.period
        # logs of short episodes: most of them must hold a window
        duration = min(duration, max(float(np.quantile(lengths, 0.3)), float(np.median(lengths)) / 2))
        # and at least one of each part
        duration = min([duration, *(max(each, default=duration) for each in parts)])
        rng = np.random.default_rng([self.config.seed, PARTS.index(part), seed])
        w = cut(getattr(self, part), self.model, self.noise, duration, limit, self.dt, rng, samples)
        return started_from_before(w, self.model, self.noise) if judged or part == "test" else w


def with_drives(
    p: Prepared,
    plain: mujoco.MjModel,
    moving: set[int],
    law: Callable[[Source], Law],
) -> Prepared:
    """The same with measured forces read as what was found of their drives makes of them.

    Args:
        plain: the nominal model. moving: actuators whose force is not held between rows, beside those that `follows`
            knows. law: of all of them, for one recording.
    """
    continuous = follows(plain)
    continuous[list(moving)] = True

    def again(s: Source) -> Source:
        return followed(s, plain, p.measured & continuous, law(s))

    return p.mapped(again)
