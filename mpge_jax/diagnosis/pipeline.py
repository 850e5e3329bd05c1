"""The whole diagnosis: read, validate, model the measurement, search, weigh, judge."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco

from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.dataset.given_motion import motion_is_given
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.diagnosis import Diagnosis
from mpge_jax.diagnosis.drives.driven_machine import as_encoders_read, driven_as_found, measured_servos
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.force_balance import procedure as force_balance
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.measurement.finer_steps import in_steps_as_seen
from mpge_jax.diagnosis.measurement.measurement_model import WAYS, MeasurementModel, Way
from mpge_jax.diagnosis.recordings.reader import read
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.selection import checkpoint
from mpge_jax.diagnosis.selection.procedure import Decision, Found, decide, go_on, look, tested
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search, check_windows
from mpge_jax.diagnosis.verdict.beside_unknown import beside_unknown
from mpge_jax.diagnosis.verdict.force_judgement import judge_forces
from mpge_jax.diagnosis.verdict.judgement import judge
from mpge_jax.diagnosis.verdict.result import Result


class Progress:
    """Says what is being done, on stderr."""

    def __init__(self, quiet: bool) -> None:
        self.quiet, self.start = quiet, time.monotonic()

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.start

    def __call__(self, text: str) -> None:
        if not self.quiet:
            print(f"[{self.seconds:5.0f} s] {text}", file=sys.stderr, flush=True)


def diagnose(
    model: str | Path | mujoco.MjSpec,
    recordings: Sequence[Recording] | Sequence[str | Path] | Recording | str | Path,
    config: Config | None = None,
    columns: Mapping[str, object] | str | Path | None = None,
    progress: Path | None = None,
) -> Diagnosis:
    """Find the physics that a model lacks.

    Args:
        model: path of an MJCF file, or an MjSpec.
        recordings: files, folders, or `Recording`s in SI units.
        config: settings. columns: renaming and conversion of columns: the file of a map (`--map`), or its content.
        progress: file that keeps the state of the search, so that an interrupted one goes on; yours to remove when
            the result is safe.

    Raises:
        InputError: the input cannot be used; the message says what to do.
    """
    config = Config() if config is None else config
    if not isinstance(config, Config):
        raise InputError(f"settings are given as Config(seed=0), not as {type(config).__name__}.")
    say = Progress(config.quiet)
    spec = load_spec(model)
    plain = compile_variable(spec)
    checked = read(recordings, plain, names_of(plain), columns)
    p = prepare(spec, checked, config)
    for doubt in p.warnings:
        say(f"take note: {doubt}")
    result = find(p, plain, say, progress)
    given = None if isinstance(model, mujoco.MjSpec) else Path(model)
    return Diagnosis(**{**vars(result), "seconds": say.seconds, "model": given})


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


Reading = tuple[MeasurementModel, Prepared, Search]
"""What recording did, the recordings read so, and a search in them."""


def find(p: Prepared, plain: mujoco.MjModel, say: Progress, progress: Path | None = None) -> Result:
    """What the model lacks, and what recording did to what was recorded: either is estimated given the other.

    The recordings are read with rows, ages, delays and zeros that no physics explains, and simulated in steps as fine
    as they show, and the search looks for physics in what that leaves.

    Where motion and force were recorded and no commands, nothing is simulated: the forces decide.

    Args:
        p: recordings as prepared. plain: the nominal model. progress: see `diagnose`.
    """
    if motion_is_given([s.recording for s in p.sources], p.model, p.measured):
        say(
            "no commands were recorded: the forces that the motion needs are compared with those that were measured"
        )
        return judge_forces(p, force_balance.decide(p, say), say)
    p, drives = driven_as_found(p, plain)
    p = in_steps_as_seen(p)
    late = {} if drives is None else drives.late(plain, p.by_law)
    measurement = MeasurementModel.without_physics(p, late, measured_servos(p, plain))
    p = measurement.read()
    s = build_search(p, say, p.config.decide_s)
    check_windows(p, s)
    if progress is not None:
        checkpoint.attach(s, p, progress)
    say(
        f"{_counted(len({x.recording.log for x in p.sources}), 'recording')}; "
        f"{_counted(len(s.terms), 'candidate')} (an effect at a place) to try: fitted to "
        f"{_counted(s.train.count, 'piece')} of {s.train.times.max():.2g} s, judged on {s.held.count} more"
    )
    (measurement, p, s), found = _alternating((measurement, p, s), say)
    found, held = beside_unknown(p, s, *tested(p, s, found), say)
    say("judging what is left")
    if drives is not None:
        drives = as_encoders_read(p, plain, drives, found.fit)
        if measurement.late:
            drives = drives.arrived(measurement.given(found.fit).delays)
    return judge(p, plain, s, found, held, drives)


def _alternating(reading: Reading, say: Progress) -> tuple[Reading, Decision]:
    """Physics given what recording did, and this given that physics, until both stand. Alternatives are weighed where
    nothing moves any more; where that ends elsewhere than the search did, the recordings are asked once more. Each of
    `WAYS` moves once, so that this ends."""
    ways: list[Way] = list(WAYS)
    found: Found = look(*reading[1:])
    while True:
        reading, found = _read_given(found, reading, ways, say)
        if isinstance(found, Decision):
            return reading, found
        _, p, s = reading
        decision = decide(p, s, say, found)
        if decision.confirms(found):
            return reading, decision
        found = decision


def _read_given(found: Found, reading: Reading, ways: list[Way], say: Progress) -> tuple[Reading, Found]:
    """The steps, the rows that commands belong to, their clock, the ages of servos' forces, after them the delays, and
    after these the zeros, told again given what was found; where they move, the search goes on from what it has on
    recordings read anew.

    Args:
        ways: those that may move; without those that did when this returns.
    """
    for way in tuple(ways):
        if not found.steady:
            break
        measurement, _, s = reading
        again = way(measurement, found)
        if again is None:
            continue
        say("the recordings are read otherwise, given what was found; going on from there")
        ways.remove(way)
        p = again.read()
        anew = build_search(p, say, p.config.decide_s)
        go_on(anew, s, found.fit)
        reading, found = (again, p, anew), look(p, anew)
    return reading, found
