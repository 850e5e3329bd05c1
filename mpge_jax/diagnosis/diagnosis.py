"""The whole diagnosis: prepare, search, weigh, judge."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis import resume
from mpge_jax.diagnosis.actuator_side import ActuatorSide, by_command, diagnose_actuators
from mpge_jax.diagnosis.arrivals import arrivals, moved, with_arrivals
from mpge_jax.diagnosis.build_search import build_search
from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.decide import Decision, decide
from mpge_jax.diagnosis.drive_noise import freed
from mpge_jax.diagnosis.drives import is_servo
from mpge_jax.diagnosis.effects.base import REGISTRY, Context
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.fitted import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.judge import (
    FitReport,
    error_drops,
    fit_report,
    locate,
    note_numerics,
    together,
    what_is_left,
)
from mpge_jax.diagnosis.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.prepare import Prepared, prepare, with_drives
from mpge_jax.diagnosis.reader import load_recordings
from mpge_jax.diagnosis.recording import Recording, chain_transitions, from_zero, unwrapped, validate
from mpge_jax.diagnosis.scored import Reached, Rival
from mpge_jax.diagnosis.select import Search
from mpge_jax.diagnosis.staleness import staleness
from mpge_jax.diagnosis.zeros import describe_zeros, other_zeros, with_zeros

Array = np.ndarray


@dataclass
class Diagnosis:
    """What is missing in a model, with everything that supports it.

    Attributes:
        verdict: "effects", "ambiguous", "unexplained" or "none".
        fit: the chosen effects with parameters and covariances. rivals: alternatives by term.
        train, held: errors before and after. location: (place, kind, excess), largest first.
        unexplained: what is left, or None. actuators: what was found between command and measured force.
    """

    verdict: str
    prepared: Prepared
    fit: Fitted
    rivals: dict[Term, list[Rival]]
    error_drop: dict[Term, float]
    train: FitReport
    held: FitReport
    location: list[tuple[str, str, float]]
    unexplained: dict[str, Any] | None
    warnings: list[str]
    config: Config
    seconds: float = 0.0
    log: list[str] = field(default_factory=list)
    actuators: ActuatorSide | None = None
    experiment: dict[str, object] | None = None

    @property
    def ctx(self) -> Context:
        return self.prepared.ctx

    @property
    def terms(self) -> tuple[Term, ...]:
        return self.fit.hypothesis.terms

    def corrected_spec(self) -> mujoco.MjSpec:
        """The nominal description with native forms of the effects added."""
        from mpge_jax.diagnosis.export import corrected_spec

        return corrected_spec(self)[0]

    def corrected_model(self) -> mujoco.MjModel:
        """Compiled model with all effects that MuJoCo has natively; `effects()` holds the others too."""
        return self.corrected_spec().compile()

    def effects(self) -> dict[str, Any]:
        """All effects in the form from which `mpge_jax.diagnosis.corrected` rebuilds them."""
        from mpge_jax.diagnosis.outputs import effects_table

        return effects_table(self)

    def corrected_env(self, task: str | None = None) -> Any:
        """The corrected machine (`corrected.CorrectedModel`); with the name of a task, that task's `envs.Env` in it."""
        from mpge_jax.diagnosis.corrected import CorrectedModel

        corrected = CorrectedModel.build(self.prepared.spec, self.effects()["effects"])
        if task is None:
            return corrected
        from mpge_jax.diagnosis.transitions import task_env

        return task_env(corrected, task)

    def to_json(self) -> dict[str, Any]:
        """The contents of `diagnosis.json`."""
        from mpge_jax.diagnosis.outputs import diagnosis_table

        return diagnosis_table(self)

    def write(self, folder: str | Path) -> None:
        """Write `diagnosis.json`, `corrected.xml`, `effects.json`, figures and `report.html`."""
        from mpge_jax.diagnosis.outputs import write

        write(self, Path(folder))


class _Progress:
    """Says what is being done, on stderr."""

    def __init__(self, quiet: bool) -> None:
        self.quiet, self.start = quiet, time.monotonic()

    def __call__(self, text: str) -> None:
        if not self.quiet:
            print(f"[{time.monotonic() - self.start:5.0f} s] {text}", file=sys.stderr, flush=True)


def diagnose(
    model: str | Path | mujoco.MjSpec,
    recordings: Sequence[Recording] | Sequence[str | Path] | str | Path,
    config: Config | None = None,
    columns: dict[str, object] | None = None,
    progress: Path | None = None,
) -> Diagnosis:
    """Find the physics that a model lacks.

    Args:
        model: path of an MJCF file, or an MjSpec.
        recordings: files, folders, or `Recording`s in SI units.
        config: settings. columns: renaming and conversion of columns (the content of `--map`).
        progress: file that keeps the state of the search, so that an interrupted one goes on; yours to remove when
            the result is safe.

    Raises:
        InputError: the input cannot be used; the message says what to do.
    """
    config = config or Config()
    say = _Progress(config.quiet)
    began = time.monotonic()
    spec = load_spec(model)
    plain = compile_variable(spec)
    names = names_of(plain)
    if isinstance(recordings, str | Path):
        recordings = [recordings]
    ready = [r for r in recordings if isinstance(r, Recording)]
    files = [r for r in recordings if not isinstance(r, Recording)]
    checked = [validate(r, plain, names) for r in ready]
    if files or not ready:
        checked += load_recordings(files, plain, names, columns)
    # transitions follow one another as they were logged, so they are joined before angles are made continuous
    checked = [from_zero(unwrapped(r, plain, names)) for r in chain_transitions(checked)]
    called = [r.name for r in checked]
    for name in called:
        if called.count(name) > 1:
            raise InputError(
                f"{called.count(name)} recordings are called '{name}'; give each a name of its own."
            )
    prepared = prepare(spec, checked, config)
    result = _diagnose(prepared, plain, say, progress)
    result.seconds = time.monotonic() - began
    return result


def _diagnose(p: Prepared, plain: mujoco.MjModel, say: _Progress, progress: Path | None) -> Diagnosis:
    at_rows, actuators = _by_measured_forces(p, plain)
    late = {} if actuators is None else actuators.late(plain)
    when = arrivals(at_rows, NOTHING, late)
    p = with_arrivals(at_rows, when)
    s = build_search(p, say, p.config.decide_s)
    _check_windows(p, s)
    if progress is not None:
        resume.attach(s, p, progress)
    recordings = len(p.train_sources) + len(p.held_sources)
    say(
        f"{recordings} recordings, {len(s.terms)} effects at their places, {s.train.count} + {s.held.count} windows"
    )
    found = decide(p, s, say)
    known = arrivals(at_rows, found.fit, late)
    if found.fit.hypothesis.terms and moved(when, known):
        # what was missing seemed to be a matter of delays
        p, s, found = _once_more(with_arrivals(at_rows, known), s, found, say)
        known = arrivals(at_rows, found.fit, late)
    zeros = {} if found.left is None else other_zeros(p, found.fit)
    if zeros:
        p.warnings.append(describe_zeros(p, zeros))
        say("the encoders' zeros differ between recordings; going on without them")
        at_rows = with_zeros(at_rows, zeros)
        p, s, found = _once_more(with_arrivals(at_rows, known), s, found, say)
        known = arrivals(at_rows, found.fit, late)
    say("judging what is left")
    f, shown, held, ratio = found.fit, (p, found.fit), found.held, found.noise.ratio
    corrected = bool(f.hypothesis.terms)
    if actuators is not None and late:
        actuators = actuators.arrived(known)
    if actuators is not None and actuators.fits:
        if not corrected:
            shown = by_command(p, plain, actuators)
            # no measured force, and no noise of one, drives this machine
            ratio = min(ratio, 1.0)
            held = fit_report(*shown, held=True)
        corrected = True
    train, held = (r.above(ratio) for r in (fit_report(*shown, held=False), held))
    unexplained = None if found.left is None else what_is_left(p, found.left, held, corrected)
    if unexplained is None:
        note_numerics(p, f, found.held.windows)
    if actuators is not None:
        unexplained = together([unexplained, *actuators.left])
    drop = error_drops(p, f, held)
    verdict = "none"
    if unexplained is not None:
        verdict = "unexplained"
    elif any(r.tied for rs in found.rivals.values() for r in rs):
        verdict = "ambiguous"
    elif corrected:
        verdict = "effects"
    location, warnings = locate(p, s), list(dict.fromkeys(p.warnings))
    return Diagnosis(
        verdict, p, f, found.rivals, drop, train, held, location, unexplained, warnings, p.config, log=s.log,
        actuators=actuators,
    )  # fmt: skip


def _once_more(p: Prepared, s: Search, found: Decision, say: _Progress) -> tuple[Prepared, Search, Decision]:
    """The decision on recordings that are read otherwise than in `s`, from what was found there on."""
    again = build_search(p, say, p.config.decide_s)
    again.log, again.resume = s.log, Reached(found.fit)
    return p, again, decide(p, again, say)


def _by_measured_forces(p: Prepared, plain: mujoco.MjModel) -> tuple[Prepared, ActuatorSide | None]:
    """The machine driven by what was found of its drives where forces were measured, and what that is."""
    tried = p.config.effects
    ids = [
        i
        for i, e in REGISTRY.items()
        if e.side == "actuator" and (tried is None or i.partition(":")[0] in tried)
    ]
    actuators = diagnose_actuators(p, plain, ids)
    if actuators is None:
        return p, None
    p = freed(p, plain, actuators)
    drives = actuators.between_rows(plain)
    p = with_drives(p, plain, *drives)
    servos = [a for a in map(int, np.flatnonzero(p.measured)) if is_servo(plain, a)]
    age = staleness(p, servos)
    if age:
        p.warnings.append(
            f"the servos' measured forces act {1e3 * age:.2g} ms late, as those of servos that compute in steps "
            "and hold their force; this is taken into account and is no missing physics."
        )
        p = with_drives(p, plain, *drives, age=dict.fromkeys(servos, age))
    return p, actuators


def _check_windows(p: Prepared, s: Search) -> None:
    c = p.config
    report = [p.windows(held, c.report_s, 1).count for held in (False, True)]
    for length, train, held, least in (
        (c.decide_s, s.train.count, s.held.count, 2),
        (c.report_s, *report, 1),
    ):
        if train < least or held < 1:
            raise InputError(
                f"the recordings hold only {train} training and {held} held-out windows of {length} s; record longer."
            )
