"""Runs `python -m experiments.diagnose` on every case as a process of its own, resumable, with the time taken."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

COMMAND = (sys.executable, "-m", "experiments.diagnose")


def run_case(
    case: Path, out: Path, jobs: int, seed: int, timeout: float, command: Sequence[str] = COMMAND
) -> dict[str, object]:
    """One case; returns {"status", "seconds", "stderr"} (status is None after `timeout` seconds)."""
    out.mkdir(parents=True, exist_ok=True)
    arguments = ["--model", case / "model.xml", "--recordings", case / "recordings", "--out", out / "report"]
    arguments += ["--seed", seed, "--jobs", jobs, "--quiet"]
    begin = time.monotonic()
    try:
        done = subprocess.run(
            [*command, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=timeout,
            errors="replace",
        )
        status, stderr = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        status, stderr = None, f"gave up after {timeout:.0f} s"
    return {"status": status, "seconds": round(time.monotonic() - begin, 2), "stderr": stderr[-2000:]}


def run_all(
    cases: Path,
    out: Path,
    only: Sequence[str] = (),
    jobs: int = 2,
    seed: int = 0,
    timeout: float = 900.0,
    retry_failed: bool = False,
    progress: Callable[[int, int], None] | None = None,
    command: Sequence[str] = COMMAND,
) -> None:
    """Run all cases one after another (times are those of a machine that does nothing else).

    Each case leaves OUT/<case>/run.json and OUT/<case>/report/. Raises FileNotFoundError when there are no cases and
    ValueError for names that do not exist.
    """
    names = sorted(p.parent.name for p in cases.glob("*/model.xml"))
    if not names:
        raise FileNotFoundError(f"no cases in {cases}: expected folders with a model.xml")
    unknown = sorted(set(only) - set(names))
    if unknown:
        raise ValueError(f"no such case: {', '.join(unknown)}")
    wanted = [name for name in names if not only or name in only]
    for number, name in enumerate(wanted):
        note = out / name / "run.json"
        finished = note.exists() and (not retry_failed or json.loads(note.read_text())["status"] == 0)
        if not finished:
            result = run_case(cases / name, out / name, jobs, seed, timeout, command)
            partial = note.with_suffix(".partial")
            partial.write_text(json.dumps(result, indent=1))
            partial.rename(note)
        if progress is not None:
            progress(number + 1, len(wanted))
