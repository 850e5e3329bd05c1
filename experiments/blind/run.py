"""Runs `python -m experiments.diagnose` on every case as a process of its own, resumable, with the time taken."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments import runners

COMMAND = (sys.executable, "-m", "experiments.diagnose")
# Where the kernel can, a diagnosis ends with the process that waits for it, or one started anew would find its folder
# in use.
_LEASH = """
import ctypes, os, signal, sys
PR_SET_PDEATHSIG = 1
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
os.execvp(sys.argv[1], sys.argv[1:])
"""


@dataclass(frozen=True)
class CaseJob:
    """What the job of a case is given: folders, and what the diagnosis is told; `timeout` in seconds."""

    case: Path
    out: Path
    jobs: int
    seed: int
    timeout: float
    command: tuple[str, ...]

    @property
    def note(self) -> Path:
        """The file that is written last."""
        return self.out / "run.json"


def run_case(given: CaseJob) -> None:
    """One case; writes {"status", "seconds", "stderr"} (status is None after `timeout` seconds)."""
    given.out.mkdir(parents=True, exist_ok=True)
    arguments = ["--model", given.case / "model.xml", "--recordings", given.case / "recordings"]
    arguments += ["--out", given.out / "report", "--seed", given.seed, "--jobs", given.jobs, "--quiet"]
    begin = time.monotonic()
    status: int | None
    try:
        done = subprocess.run(
            [sys.executable, "-S", "-c", _LEASH, *given.command, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=given.timeout,
            errors="replace",
        )
        status, stderr = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        status, stderr = None, f"gave up after {given.timeout:.0f} s"
    result = {"status": status, "seconds": round(time.monotonic() - begin, 2), "stderr": stderr[-2000:]}
    partial = given.note.with_suffix(".partial")
    partial.write_text(json.dumps(result, indent=1))
    partial.rename(given.note)


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
    options: runners.Options | None = None,
) -> None:
    """Run all cases, one after another where `options` say nothing else (times are then those of a machine that does
    nothing else).

    Each case leaves OUT/<case>/run.json and OUT/<case>/report/. Raises FileNotFoundError when there are no cases and
    ValueError for names that do not exist, or a runner that is not installed.
    """
    names = sorted(p.parent.name for p in cases.glob("*/model.xml"))
    if not names:
        raise FileNotFoundError(f"no cases in {cases}: expected folders with a model.xml")
    unknown = sorted(set(only) - set(names))
    if unknown:
        raise ValueError(f"no such case: {', '.join(unknown)}")
    options = options or runners.Options()
    runners.check(options)
    # Whole paths, so that any process finds them.
    cases, out = cases.resolve(), out.resolve()
    wanted = [name for name in names if not only or name in only]
    given = [CaseJob(cases / n, out / n, jobs, seed, timeout, tuple(command)) for n in wanted]
    if retry_failed:
        for each in given:
            if each.note.exists() and json.loads(each.note.read_text())["status"] != 0:
                each.note.unlink()
    work = [runners.Job(each.out.name, run_case, each, each.note) for each in given]
    for number, ended in enumerate(runners.run(work, options, out / "jobs"), 1):
        if ended.state == "failed":
            print(f"{ended.name}: {ended.reason}", file=sys.stderr)
        if progress is not None:
            progress(number, len(wanted))
