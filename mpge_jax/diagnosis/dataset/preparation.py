"""From a model and recordings to windows: everything before the search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.dataset.coarse_sampling import (
    as_large_as_motion,
    bound,
    holds_states,
    is_coarse,
    states_as_measured,
)
from mpge_jax.diagnosis.dataset.cut_windows import choose_dt
from mpge_jax.diagnosis.dataset.given_motion import motion_is_given
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.checks import (
    check_base,
    check_commands,
    check_copies,
    check_forces,
    check_model,
    check_motion,
    check_units,
    told_once,
)
from mpge_jax.diagnosis.recordings.measurement_noise import noise_of
from mpge_jax.diagnosis.recordings.noise_level import MIN_ROWS
from mpge_jax.diagnosis.recordings.recording import Recording, rows_of, shown
from mpge_jax.diagnosis.recordings.rows.clock_stamps import at_their_stamps
from mpge_jax.diagnosis.recordings.rows.late_rows import without_previous_commands
from mpge_jax.diagnosis.recordings.states import MAX_ROWS, told_with_commands
from mpge_jax.diagnosis.recordings.three_parts import three_parts
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.driving.force_between_rows import source_of
from mpge_jax.diagnosis.simulation.driving.measured_drives import drive_by_force, measured_forces
from mpge_jax.diagnosis.simulation.scales import build_context


def _thin(recordings: list[Recording], warnings: list[str]) -> list[Recording]:
    """Cut very long logs to evenly spread stretches."""
    total = sum(r.time.size for r in recordings)
    if total <= MAX_ROWS:
        return recordings
    recordings = [shown(r) for r in recordings]
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
    recordings, notes = without_previous_commands(recordings, plain)
    warnings = notes + told_once(recordings)
    rng = np.random.default_rng(config.seed)
    measured = measured_forces(recordings, plain)
    # where forces are predicted, parts of all that may be looked at choose what was fitted to the others
    chosen = not motion_is_given(recordings, plain, measured)
    parts = three_parts(recordings, config.held_out, rng, chosen)
    warnings += parts.warnings
    tests = {r.name for r in parts.test}
    whole = [r for r in parts.test if not r.part_of]
    check_copies([r for r in recordings if r.name not in tests], whole, warnings)
    check_commands(recordings, measured, names)
    check_base(recordings, plain, names)
    check_forces(recordings, measured, names, warnings)
    model = compile_variable(drive_by_force(spec, measured))
    train, choice, test = (_thin(part, warnings) for part in (parts.train, parts.choice, parts.test))
    looked_at = len(train) + len(choice)
    recorded = train + choice + test
    together, notes = at_their_stamps(recorded, plain, names)
    warnings += notes
    noise, notes = noise_of(together[:looked_at], model, names, recorded[:looked_at])
    warnings += notes
    states = told_with_commands(together, model, noise, plain, looked_at)
    sources = tuple(source_of(r, s, plain, measured) for r, s in zip(together, states, strict=True))
    check_motion(together, model, names, noise, warnings)
    check_units(together, list(states), model, names, [s.command for s in sources])
    ctx = build_context(model, names, sources[: len(train)])
    dt = choose_dt(together, float(plain.opt.timestep))
    sim = Simulator(model, ctx, threads=config.jobs)
    seen = together[:looked_at]
    short, estimated = max(r.time.size for r in seen) < MIN_ROWS, noise
    by_rows = short and holds_states(seen, model, noise)
    if by_rows:
        noise = as_large_as_motion(seen, noise)
    if by_rows or is_coarse(seen, model, noise):
        known = all_terms(ctx, config.effects)
        terms = [t for t in known if t.effect.simulated and not t.effect.senses]
        noise = bound(sim, sources[: len(train)], noise, terms, dt, config.seed)
        if noise.direct:
            measured_states = states_as_measured(together, model, noise)
            sources = tuple(replace(s, states=x) for s, x in zip(sources, measured_states, strict=True))
            ctx = build_context(model, names, sources[: len(train)])
            sim = Simulator(model, ctx, threads=config.jobs)
    if short and not noise.direct:
        noise = estimated
        warnings.append("recordings are too short to estimate noise; they are taken as nearly noise-free.")
    check_model(plain, names, warnings)
    return Prepared(
        spec, sim.model, names, sim.ctx, sim, noise, sources[: len(train)], sources[len(train) : looked_at],
        sources[looked_at:], dt, measured, warnings, config, float(plain.opt.timestep),
    )  # fmt: skip
