"""Jobs that cost nothing, for the tests of the runners."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from experiments.runners import Job, Refused
from mpge_jax import files


@dataclass(frozen=True)
class Sum:
    """What a job adds up.

    Attributes:
      upto: numbers 1 to `upto` are added.
      folder: of the job.
      seconds: that it takes.
      how: `ends`, or how it goes wrong: `raises`, `refuses`, `forgets` its result, `dies`.
    """

    upto: int
    folder: Path
    seconds: float = 0.0
    how: str = "ends"


def add(given: Sum) -> None:
    """Writes the sum, and a line in the list of the begun and of the ended jobs."""
    _note(given.folder.parent / "begun.txt", given)
    time.sleep(given.seconds)
    if given.how == "raises":
        raise FloatingPointError("it diverged\nand a thousand lines of XLA")
    if given.how == "refuses":
        raise Refused("run_3.npz: time does not increase; sort its rows.")
    if given.how == "forgets":
        return
    if given.how == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    files.write_text(given.folder / "sum.txt", f"{sum(range(1, given.upto + 1))}\n")
    _note(given.folder.parent / "ended.txt", given)


def _note(path: Path, given: Sum) -> None:
    with path.open("a") as file:
        file.write(f"{given.folder.name}\n")


def sums(folder: Path, count: int, **each: dict) -> list[Job]:
    """Jobs `job_0`, `job_1`, ...; those named in `each` with other settings."""
    given = [Sum(10 * n, folder / f"job_{n}", **each.get(f"job_{n}", {})) for n in range(count)]
    return [Job(g.folder.name, add, g, g.folder / "sum.txt") for g in given]


def results_of(folder: Path) -> dict[str, bytes]:
    """What the jobs wrote, without what they took."""
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.glob("job_*/*"))
        if p.name != "cost.json"
    }
