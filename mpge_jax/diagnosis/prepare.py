"""From a model and recordings to windows: everything before the search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.activations import settling
from mpge_jax.diagnosis.between_rows import Law, followed, source_of
from mpge_jax.diagnosis.candidates import all_terms
from mpge_jax.diagnosis.checks import (
    check_base,
    check_commands,
    check_copies,
    check_forces,
    check_model,
    check_motion,
    told_once,
)
from mpge_jax.diagnosis.clock import at_their_stamps
from mpge_jax.diagnosis.coarse import as_large_as_motion, bound, holds_states, is_coarse, states_as_measured
from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.context import build_context
from mpge_jax.diagnosis.drives import drive_by_force, follows, measured_forces
from mpge_jax.diagnosis.effects.base import Context
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.model import Names, compile_variable, load_spec, names_of
from mpge_jax.diagnosis.noise import MIN_ROWS
from mpge_jax.diagnosis.recording import Recording, rows_of
from mpge_jax.diagnosis.simulate import Simulator
from mpge_jax.diagnosis.source import Source
from mpge_jax.diagnosis.split import split
from mpge_jax.diagnosis.states import MAX_ROWS, Noise, estimate
from mpge_jax.diagnosis.windows import MAX_SAMPLES, Windows, choose_dt, cut

SPARSE = 0.2
"""Time between rows, over the length of a window, beyond which windows last whole rows."""


@dataclass
class Prepared:
    """Inputs of the search.

    Attributes:
        spec: the nominal description. model: its compiled form (mechanical side: driven by measured forces
        where these exist). measured: [nu] whether an actuator's force was measured and commanded. known: [nu] whether
        that force is its law's, without the noise of its measurement (None: of none).
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    names: Names
    ctx: Context
    sim: Simulator
    noise: Noise
    train_sources: tuple[Source, ...]
    held_sources: tuple[Source, ...]
    dt: float
    measured: np.ndarray
    warnings: list[str]
    config: Config
    timestep: float
    known: np.ndarray | None = None

    def windows(
        self, held: bool, duration: float, limit: int, seed: int = 0, samples: int = MAX_SAMPLES
    ) -> Windows:
        """At most `limit` windows of at most `samples` rows, of `duration` s or shorter where recordings are."""
        sources = self.held_sources if held else self.train_sources
        lengths = [
            s.recording.duration - settling(s, self.model) for s in self.train_sources + self.held_sources
        ]
        if self.ctx.period > SPARSE * duration:
            duration = float(np.ceil(duration / self.ctx.period - 1e-6)) * self.ctx.period
        # logs of short episodes: most of them must hold a window
        duration = min(duration, max(float(np.quantile(lengths, 0.3)), float(np.median(lengths)) / 2))
        # and at least one of either kind
        trained = len(self.train_sources)
        duration = min(
            duration, max(lengths[:trained], default=duration), max(lengths[trained:], default=duration)
        )
        rng = np.random.default_rng([self.config.seed, int(held), seed])
        return cut(sources, self.model, self.noise, duration, limit, self.dt, rng, samples)


def with_drives(
    p: Prepared,
    plain: mujoco.MjModel,
    moving: set[int],
    law: Callable[[Source], Law],
    age: dict[int, float] | None = None,
) -> Prepared:
    """The same with measured forces read as what was found of their drives makes of them.

    Args:
        plain: the nominal model. moving: actuators whose force is not held between rows, beside those that `follows`
            knows. law: of all of them, for one recording. age: actuator -> `staleness` (s).
    """
    continuous = follows(plain)
    continuous[list(moving)] = True
    ages = np.array([(age or {}).get(a, 0.0) for a in range(plain.nu)])

    def again(s: Source) -> Source:
        return followed(s, plain, p.measured & continuous, law(s), ages)

    return replace(
        p,
        train_sources=tuple(map(again, p.train_sources)),
        held_sources=tuple(map(again, p.held_sources)),
    )


def _thin(recordings: list[Recording], warnings: list[str]) -> list[Recording]:
    """Cut very long logs to evenly spread stretches."""
    total = sum(r.time.size for r in recordings)
    if total <= MAX_ROWS:
        return recordings
    warnings.append(
        f"{total} rows are more than needed; evenly spread stretches of {MAX_ROWS} rows are used."
    )
    out = []
    for r in recordings:
        budget = max(int(MAX_ROWS * r.time.size / total), 50)
        pieces = max(1, budget // 2000)
        size = budget // pieces
        starts = np.linspace(0, max(r.time.size - size, 0), pieces).astype(int)
        for k, a in enumerate(starts):
            rows = slice(int(a), int(a) + size)
            out.append(rows_of(r, rows, r.name if pieces == 1 else f"{r.name}_{k}"))
    return out


def prepare(source, recordings: list[Recording], config: Config) -> Prepared:
    """Split, estimate noise and states, and set the scales.

    Args:
        source: path or MjSpec of the nominal model. recordings: already validated.
    """
    if not recordings:
        raise InputError("no recording was given.")
    spec = load_spec(source)
    plain = compile_variable(spec)
    names = names_of(plain)
    warnings = told_once(recordings)
    rng = np.random.default_rng(config.seed)
    train, held, notes = split(recordings, config.held_out, rng)
    warnings += notes
    check_copies(train, held, warnings)
    measured = measured_forces(recordings, plain)
    check_commands(recordings, measured, names)
    check_base(recordings, plain, names)
    check_forces(recordings, measured, names, warnings)
    model = compile_variable(drive_by_force(spec, measured))
    train, held = _thin(train, warnings), _thin(held, warnings)
    recorded = train + held
    together, notes = at_their_stamps(recorded, plain, names)
    warnings += notes
    noise, states, notes = estimate(together, model, names, recorded)
    warnings += notes
    sources = tuple(source_of(r, s, plain, measured) for r, s in zip(together, states, strict=True))
    train_sources, held_sources = sources[: len(train)], sources[len(train) :]
    ctx = build_context(model, names, train_sources)
    dt = choose_dt(together, float(plain.opt.timestep))
    sim = Simulator(model, ctx, threads=config.jobs)
    short, estimated = max(r.time.size for r in together) < MIN_ROWS, noise
    whole = short and holds_states(together, model, noise)
    if whole:
        noise = as_large_as_motion(together, noise)
    if whole or is_coarse(together, model, noise):
        terms = [t for t in all_terms(ctx, config.effects) if not t.effect.senses]
        noise = bound(sim, train_sources, noise, terms, dt, config.seed)
        if noise.direct:
            measured_states = states_as_measured(together, model, noise)
            sources = tuple(replace(s, states=x) for s, x in zip(sources, measured_states, strict=True))
            train_sources, held_sources = sources[: len(train)], sources[len(train) :]
            ctx = build_context(model, names, train_sources)
            sim = Simulator(model, ctx, threads=config.jobs)
    if short and not noise.direct:
        noise = estimated
        warnings.append("recordings are too short to estimate noise; they are taken as nearly noise-free.")
    check_motion(together, model, names, noise, warnings)
    check_model(plain, names, warnings)
    return Prepared(
        spec, sim.model, names, sim.ctx, sim, noise, train_sources, held_sources, dt, measured, warnings, config,
        float(plain.opt.timestep),
    )  # fmt: skip
