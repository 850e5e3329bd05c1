"""The job of one robot: its diagnosis, in a folder of its own."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.runners import Ended, Job, Refused
from mpge_jax import files
from mpge_jax.diagnosis import Config, InputError, diagnose, load_effects, load_readers

RESULT, GIVEN, FAILED = "diagnosis.json", "given.json", "failed.json"


@dataclass(frozen=True)
class Settings:
    """What all robots of a fleet have in common.

    Attributes:
      model: MJCF or URDF file.
      effects: identifiers to try; None: all.
      effects_files: Python files that register effects of one's own.
      reader_files: Python files that register readers of one's own for logs.
      map: YAML file that renames and converts columns, or None.
      seed: of every random choice.
      threads: of one diagnosis.
    """

    model: Path
    effects: tuple[str, ...] | None = None
    effects_files: tuple[Path, ...] = ()
    reader_files: tuple[Path, ...] = ()
    map: Path | None = None
    seed: int = 0
    threads: int = 1

    def config(self) -> Config:
        """The settings of a diagnosis; raises ValueError for what it cannot be."""
        return Config(effects=self.effects, seed=self.seed, jobs=self.threads, quiet=True)

    def identity(self) -> dict[str, Any]:
        """What decides the results, to be compared with that of an earlier run. Files go by their contents."""
        paths = [self.model, *self.effects_files, *self.reader_files]
        paths += [] if self.map is None else [self.map]
        return {
            "files": {path.name: zlib.crc32(path.read_bytes()) for path in paths},
            "effects": None if self.effects is None else list(self.effects),
            "seed": self.seed,
        }


@dataclass(frozen=True)
class RobotJob:
    """What the job of a robot is given.

    Attributes:
      settings: of the fleet.
      recordings: folder of this robot's recordings.
      out: folder of its diagnosis.
    """

    settings: Settings
    recordings: Path
    out: Path

    def given(self) -> list[list[Any]]:
        """Name, bytes and time of every recording: where they differ from those of a diagnosis, it is of others."""
        found = [path for path in sorted(self.recordings.rglob("*")) if path.is_file()]
        stats = [(path.relative_to(self.recordings), path.stat()) for path in found]
        return [[str(name), stat.st_size, stat.st_mtime_ns] for name, stat in stats]


def diagnose_robot(given: RobotJob) -> None:
    """Diagnoses a robot and writes its folder; the work of a job.

    Raises:
      Refused: its recordings cannot be used.
    """
    try:
        for file in given.settings.effects_files:
            load_effects(file)
        for file in given.settings.reader_files:
            load_readers(file)
        progress = given.out / ".progress.json"
        recorded = given.given()
        result = diagnose(
            given.settings.model, [given.recordings], given.settings.config(), given.settings.map, progress
        )
    except InputError as error:
        raise Refused(str(error)) from None
    files.write_text(given.out / GIVEN, json.dumps(recorded))
    result.write(given.out)
    progress.unlink(missing_ok=True)


def jobs_of(settings: Settings, robots: Path, out: Path) -> list[Job]:
    """A job for every folder in `robots`; a diagnosis of other recordings than there are now is taken away.

    Raises:
      ValueError: there are no robots.
    """
    folders = sorted(p for p in robots.iterdir() if p.is_dir() and not p.name.startswith("."))
    if not folders:
        raise ValueError(
            f"--robots {robots} has no folders: it needs one folder of recordings for each robot"
        )
    given = [RobotJob(settings, folder.resolve(), out.resolve() / folder.name) for folder in folders]
    for each in given:
        if (each.out / RESULT).exists() and _read(each.out / GIVEN) != each.given():
            (each.out / RESULT).unlink()
    return [Job(each.out.name, diagnose_robot, each, each.out / RESULT) for each in given]


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def keep_outcome(ended: Ended, out: Path) -> None:
    """Notes why a robot failed, or that it no longer does."""
    note = out / ended.name / FAILED
    if ended.state == "failed":
        files.write_text(note, json.dumps({"reason": ended.reason, "details": ended.details}, indent=1))
    else:
        note.unlink(missing_ok=True)


def tables(jobs: list[Job]) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """The contents of every robot's `diagnosis.json`, and why the others failed."""
    found, failed = {}, {}
    for job in jobs:
        table = _read(job.result)
        if isinstance(table, dict):
            found[job.name] = table
        else:
            note = _read(job.result.with_name(FAILED))
            failed[job.name] = note["reason"] if note else f"{job.result} cannot be read; remove it and go on"
    return found, failed
