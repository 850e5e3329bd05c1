"""A job, how it is done once, and how it ended."""

from __future__ import annotations

import contextlib
import json
import resource
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from mpge_jax import files

COST = "cost.json"
"""Beside the result of every job: what it took."""
_POLL_S = 0.2


class Refused(ValueError):
    """A job's input cannot be used; the message is the whole reason, in one sentence."""


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
      name: what it is called, in one run only once.
      work: a function of a module, so that any process finds it; it writes `result` last, and in one step.
      given: all that decides the result, to be pickled.
      result: a file in the job's own folder; where it stands the job is done.
    """

    name: str
    work: Callable[[Any], object]
    given: Any
    result: Path


@dataclass(frozen=True)
class Cost:
    """What a job took where it ran to its end.

    Attributes:
      seconds: by the clock.
      cpu_seconds: of all threads, and of processes that it started.
      peak_mb: most resident memory of the process so far, or of the largest that it started, in 10^6 bytes.
    """

    seconds: float
    cpu_seconds: float
    peak_mb: float


@dataclass(frozen=True)
class Ended:
    """How a job ended.

    Attributes:
      name: of the job.
      state: `done` now; `before`, its result stood already; `failed`.
      reason: why it failed, in one line.
      details: the traceback, where it raised an exception.
      cost: of a job that was done now.
    """

    name: str
    state: Literal["done", "before", "failed"]
    reason: str = ""
    details: str = ""
    cost: Cost | None = None


def perform(job: Job) -> Ended:
    """Does a job, unless its result stands. What it raises is told and does not stop others.

    A job that was started anew may still run where it was first, on a machine that only its network left: its folder
    is held by one process at a time, and whoever comes second finds the result.
    """
    with contextlib.ExitStack() as held:
        while True:
            try:
                held.enter_context(files.held(job.result.parent))
                break
            except files.FolderInUse:
                time.sleep(_POLL_S)
        if job.result.exists():
            return Ended(job.name, "before")
        start, begun = time.monotonic(), _cpu_seconds()
        try:
            job.work(job.given)
        except Exception as error:
            return Ended(job.name, "failed", reason_of(error), traceback.format_exc())
        if not job.result.exists():
            return Ended(job.name, "failed", f"it ended without its result, {job.result}")
        cost = Cost(round(time.monotonic() - start, 2), round(_cpu_seconds() - begun, 2), _peak_mb())
        files.write_text(job.result.with_name(COST), json.dumps(asdict(cost), indent=1))
        return Ended(job.name, "done", cost=cost)


def reason_of(error: Exception) -> str:
    """An exception in one line: those of XLA run over many."""
    first = str(error).strip().partition("\n")[0]
    return first if isinstance(error, Refused) else f"{type(error).__name__}: {first}"


def _cpu_seconds() -> float:
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _peak_mb() -> float:
    # macOS counts bytes, Linux KiB.
    unit = 1e-6 if sys.platform == "darwin" else 1024e-6
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return round(max(usage.ru_maxrss for usage in usages) * unit, 1)
