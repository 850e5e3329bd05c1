"""The whole diagnosis: prepare, search, weigh, judge."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis import resume
from mpge_jax.diagnosis.actuator_side import ActuatorSide, diagnose_actuators
from mpge_jax.diagnosis.calibrate import Floor, floor, force_noise
from mpge_jax.diagnosis.candidates import all_terms
from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.effects.base import REGISTRY, Context
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.finish import final_fit, prune, refined
from mpge_jax.diagnosis.fit import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.judge import FitReport, error_drops, fit_report, helps, locate, remains, what_is_left
from mpge_jax.diagnosis.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.prepare import Prepared, drive_by_force, is_servo, prepare, with_drives
from mpge_jax.diagnosis.reader import load_recordings
from mpge_jax.diagnosis.recording import Recording, validate
from mpge_jax.diagnosis.rivals import better_rival, find_rivals
from mpge_jax.diagnosis.search import search
from mpge_jax.diagnosis.select import Rival, Scored, Search
from mpge_jax.diagnosis.simulate import Run, Simulator
from mpge_jax.diagnosis.staleness import staleness
from mpge_jax.diagnosis.telling import telling_windows
from mpge_jax.diagnosis.whiten import whitener
from mpge_jax.diagnosis.windows import Source, Windows

Array = np.ndarray
POOL = 3
"""Training windows that are looked at for each one that is fitted."""
FEWEST = 8
"""Windows that it takes at least to look once more."""
REFINED = 60
"""Windows of the reported length, at most, from which parameters are refined in the end."""
EXCHANGES = 2
"""Terms that may be exchanged for better ones once the whole hypothesis is known."""


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
        progress: file that keeps the state of the search, so that an interrupted one goes on; removed at the end.

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
    called = [r.name for r in checked]
    for name in called:
        if called.count(name) > 1:
            raise InputError(
                f"{called.count(name)} recordings are called '{name}'; give each a name of its own."
            )
    say(f"reading {len(checked)} recordings")
    prepared = prepare(spec, checked, config)
    result = _diagnose(prepared, plain, say, progress)
    if progress is not None:
        progress.unlink(missing_ok=True)
    result.seconds = time.monotonic() - began
    return result


def _diagnose(p: Prepared, plain: mujoco.MjModel, say: _Progress, progress: Path | None) -> Diagnosis:
    c = p.config
    ids = [
        i
        for i, e in REGISTRY.items()
        if e.side == "actuator" and (c.effects is None or i.partition(":")[0] in c.effects)
    ]
    actuators = diagnose_actuators(p, plain, ids)
    if actuators is not None:
        drives = actuators.between_rows()
        p = with_drives(p, plain, *drives)
        servos = [a for a in map(int, np.flatnonzero(p.measured)) if is_servo(plain, a)]
        age = staleness(p, servos)
        if age:
            p.warnings.append(
                f"the servos' measured forces act {1e3 * age:.2g} ms late, as those of servos that compute in steps "
                "and hold their force; this is taken into account and is no missing physics."
            )
            p = with_drives(p, plain, *drives, age=dict.fromkeys(servos, age))
    s = _build_search(p, say, c.decide_s)
    _check_windows(p, s)
    if progress is not None:
        resume.attach(s, p, progress)
    say(f"{len(s.terms)} effects at their places, {s.train.count} + {s.held.count} windows")
    decided, rivals = _settle(s, *search(s))
    noise, more = _left(p, s, decided)
    if not decided.hypothesis.terms and not more:
        decided, rivals = _look_again(p, s, say)
        noise, more = _left(p, s, decided) if decided.hypothesis.terms else (noise, more)
    f = decided
    # what nobody knows adds up in longer windows and pulls parameters along
    if decided.theta.size and not more and c.report_s > c.decide_s:
        say("refining parameters")
        f = refined(s, decided, p.windows(False, c.report_s, REFINED))
    held = fit_report(p, f, held=True)
    if not helps(held):
        s.log.append(f"dropped: {f.hypothesis} predicts held-out recordings no better")
        f, decided, rivals = NOTHING, NOTHING, {}
        held = fit_report(p, f, held=True)
        noise, more = _left(p, s, decided)
    say("judging what is left")
    shown, ratio = (p, f), noise.ratio
    if actuators is not None and actuators.fits and not f.hypothesis.terms:
        shown = by_command(p, plain, actuators)
        # no measured force, and no noise of one, drives this machine
        ratio = min(ratio, 1.0)
        held = fit_report(*shown, held=True)
    train, held = (r.above(ratio) for r in (fit_report(*shown, held=False), held))
    found = bool(f.hypothesis.terms) or (actuators is not None and bool(actuators.fits))
    unexplained = what_is_left(p, s, decided, held, found) if more else None
    drop = error_drops(p, f, held)
    ambiguous = any(r.tied for rs in rivals.values() for r in rs)
    verdict = "none"
    if unexplained is not None:
        verdict = "unexplained"
    elif ambiguous:
        verdict = "ambiguous"
    elif found:
        verdict = "effects"
    warnings = list(dict.fromkeys(p.warnings))
    location = locate(p, s)
    return Diagnosis(
        verdict, p, f, rivals, drop, train, held, location, unexplained, warnings, c, log=s.log,
        actuators=actuators,
    )  # fmt: skip


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


def _left(p: Prepared, s: Search, f: Fitted) -> tuple[Floor, bool]:
    """What noise alone would leave if `f` were true, and whether more than that remains."""
    noise = floor(p, f)
    return noise, remains(s, f, noise)


def _look_again(p: Prepared, s: Search, say: _Progress) -> tuple[Fitted, dict[Term, list[Rival]]]:
    """Search longer windows, where slight effects add up, after nothing was found in those of `s`."""
    longer = _build_search(p, say, p.config.report_s)
    if longer.train.steps <= s.train.steps or min(longer.train.count, longer.held.count) < FEWEST:
        return NOTHING, {}
    say("looking for slight effects in longer windows")
    found = _settle(longer, *search(longer))
    s.log += longer.log
    return found


def _settle(s: Search, f: Fitted, last: list[Scored]) -> tuple[Fitted, dict[Term, list[Rival]]]:
    """The final fit with its rivals, after exchanging terms for rivals that predict clearly better."""
    for left in reversed(range(EXCHANGES + 1)):
        f, whites = final_fit(s, prune(s, f))
        best = s.score([f], whites)[0]
        rivals = find_rivals(s, best, whites, last)
        better = better_rival(rivals)
        if better is None or not left:
            break
        s.log.append(f"exchanged: {f.hypothesis} -> {better.fit.hypothesis}")
        s.resume = better.fit
        f, last = search(s)
    return f, rivals


def _build_search(p: Prepared, say: _Progress, length: float) -> Search:
    """A search that decides by windows of a length (s)."""
    c = p.config
    train, typical = _training_windows(p, length)
    held = p.windows(True, length, c.held_windows)
    sides = {"mechanical", "sensor"} if p.measured.all() and p.measured.size else None
    terms = all_terms(p.ctx, c.effects, sides)
    terms = [t for t in terms if not (t.effect.side == "actuator" and p.measured[t.place.index])]
    terms = [t for t in terms if _visible(p, t)]
    limit = c.max_effects if c.max_effects is not None else 3 * p.model.nv + 3
    shaken = force_noise(p)
    calibrated = partial(floor, p, shaken=shaken) if shaken.any() else None
    return Search(
        p.sim, p.noise, train, held, terms, c.seed, say, max_terms=limit, typical=typical, floor=calibrated
    )


def _training_windows(p: Prepared, length: float) -> tuple[Windows, int]:
    """Windows to fit, and how many of them were drawn at random (the first ones)."""
    pool = p.windows(False, length, POOL * p.config.train_windows)
    if pool.count <= p.config.train_windows:
        return pool, pool.count
    nothing = Hypothesis()
    white = whitener(p.sim, nothing, np.zeros(0), pool, p.noise)
    x = white.excess(white(p.sim.residuals([Run(nothing, np.zeros(0))], pool)))[0]
    rng = np.random.default_rng([p.config.seed, 3])
    index, typical = telling_windows(x, p.config.train_windows, rng)
    return pool.take(index), typical


def _visible(p: Prepared, term: Term) -> bool:
    """Sensor effects need their sensor."""
    if not term.effect.senses:
        return True
    column = p.ctx.qadr(term.place)
    return any(not np.isnan(s.recording.qpos[:, column]).all() for s in p.train_sources)


def by_command(p: Prepared, plain: mujoco.MjModel, found: ActuatorSide) -> tuple[Prepared, Fitted]:
    """The machine driven by its commands rather than by measured forces, with what was found between the two: where
    nothing is missing on the mechanical side, only this shows what the correction changes."""
    sources = []
    for group in (p.train_sources, p.held_sources):
        built = (
            Source.build(s.recording, s.states, s.recording.known("ctrl"), late=plain.actuator_delay)
            for s in group
        )
        sources.append(tuple(built))
    model = compile_variable(drive_by_force(p.spec, np.zeros_like(p.measured)))
    sim = Simulator(model, found.ctx, threads=p.config.jobs)
    parts = {t: x for f in found.fits for t, x in f.hypothesis.split(found.ctx, f.theta).items()}
    hypothesis = Hypothesis.of(*parts)
    theta = hypothesis.gather(sim.ctx, parts)
    driven = replace(
        p, model=sim.model, ctx=sim.ctx, sim=sim, train_sources=sources[0], held_sources=sources[1],
        measured=np.zeros_like(p.measured),
    )  # fmt: skip
    return driven, Fitted(hypothesis, theta, theta)
