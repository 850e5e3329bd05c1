"""A search for effects over windows of one length: which windows are fitted, and what may be looked for."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial

import numpy as np

from mpge_jax.diagnosis.dataset.informative_windows import telling_windows
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import whitener
from mpge_jax.diagnosis.evidence.null_distribution import Floor, floor, force_noise
from mpge_jax.diagnosis.force_balance.driven import forces_are_known, missing_by_forces
from mpge_jax.diagnosis.recordings.three_parts import PARTS
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import stride
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
POOL = 3
"""Training windows that are looked at for each one that is fitted."""
FEWEST_ROWS = 3
"""Rows after a window's start without which a late sensor, whose first rows lie before it, would explain everything."""


def build_search(p: Prepared, say: Callable[[str], None], length: float) -> Search:
    """A search that decides by windows of a length (s)."""
    c = p.config
    train, typical = _training_windows(p, length)
    held = p.windows("choice", length, c.choice_windows)
    sides = {"mechanical", "sensor"} if p.measured.all() and p.measured.size else None
    terms = [t for t in all_terms(p.ctx, c.effects, sides) if t.effect.simulated]
    terms = [t for t in terms if not (t.effect.side == "actuator" and p.measured[t.place.index])]
    terms = [t for t in terms if _visible(p, t, train)]
    if c.masses_within:
        terms.append(given_inertias(c.masses_within))
    limit = c.max_effects if c.max_effects is not None else 3 * p.model.nv + 3
    shaken = force_noise(p)
    calibrated = _remembered(p, length, shaken) if shaken.any() or p.ctx.contacts else None
    return Search(
        p.sim,
        p.noise,
        train,
        held,
        length,
        terms,
        c.seed,
        say,
        max_terms=limit,
        typical=typical,
        by_forces=partial(missing_by_forces, p) if forces_are_known(p) else None,
        floor=calibrated,
    )


def _remembered(p: Prepared, length: float, shaken: Array) -> Callable[[Fitted], Floor]:
    """The `floor` of fits, each simulated once: a search asks of one again and again whether it leaves more."""
    known = dict[Hashable, tuple[Floor, float]]()

    def floor_of(f: Fitted) -> Floor:
        key, before = Run(f.hypothesis, f.theta).key, p.sim.work
        if key not in known:
            found = floor(p, f, length, shaken)
            known[key] = found, p.sim.work - before
        found, work = known[key]
        # what is decided by the work does not hang on what is remembered
        p.sim.work = before + work
        return found

    return floor_of


def _training_windows(p: Prepared, length: float) -> tuple[Windows, int]:
    """Windows to fit, and how many of them were drawn at random (the first ones); sets the simulator's `stride`."""
    pool = p.windows("train", length, POOL * p.config.train_windows)
    p.sim.stride = stride(p.sim, pool)
    if pool.count <= p.config.train_windows:
        return pool, pool.count
    nothing = Hypothesis()
    white = whitener(p.sim, nothing, np.zeros(0), pool, p.noise)
    x = white.excess(white(p.sim.residuals([Run(nothing, np.zeros(0))], pool)))[0]
    rng = np.random.default_rng([p.config.seed, 3])
    index, typical = telling_windows(x, p.config.train_windows, rng)
    return pool.take(index), typical


def _visible(p: Prepared, term: Term, w: Windows) -> bool:
    """Sensor effects need their sensor, and a late one more rows than it may be late by."""
    if not term.effect.senses:
        return True
    if term.id == "sensor_delay" and np.median(w.seen.sum(1)) < FEWEST_ROWS:
        return False
    column = p.ctx.qadr(term.place)
    return any(not np.isnan(s.recording.qpos[:, column]).all() for s in p.train)


def check_windows(p: Prepared, s: Search) -> None:
    """Raises InputError where the recordings hold too few windows to decide by or to report on."""
    c = p.config
    report = [p.windows(part, c.report_s, 1).count for part in PARTS]
    deciding = [s.train.count, s.held.count, p.windows("test", c.decide_s, 1).count]
    for length, counts, least in ((c.decide_s, deciding, (2, 1, 1)), (c.report_s, report, (1, 1, 1))):
        if any(n < k for n, k in zip(counts, least, strict=True)):
            train, choice, test = counts
            raise InputError(
                f"the recordings hold only {train} windows of {length} s to train on, {choice} to choose by and {test} "
                "to test with; record longer."
            )
