"""Jobs as arrays of Slurm, by submitit."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import submitit
from submitit.core.utils import FailedJobError, FailedSubmissionError
from submitit.helpers import Checkpointable

from experiments.runners.job import Ended, Job, perform
from experiments.runners.options import ARRAY, Options

_POLL_S = 1.0


class Resumable(Checkpointable):
    """A job that Slurm interrupts, for its time or for a job that goes first, is queued again and goes on."""

    def __call__(self, job: Job) -> Ended:
        return perform(job)


def run(jobs: Sequence[Job], options: Options, logs: Path) -> Iterator[Ended]:
    """Submits jobs and waits for them, which end in any order.

    They go on when this process ends. The same command then submits what has no result anew: what still runs is waited
    for in its folder, and found done. Scripts and logs lie in `logs`.

    Raises:
      ValueError: Slurm refuses them.
    """
    executor = executor_of(options, logs)
    running: list[tuple[Job, Any]] = []
    for first in range(0, len(jobs), ARRAY):
        part = jobs[first : first + ARRAY]
        try:
            running += zip(part, executor.map_array(Resumable(), part), strict=True)
        except (FailedJobError, FailedSubmissionError) as error:
            last = str(error).strip().rpartition("\n")[2]
            raise ValueError(
                f"Slurm refused jobs {first + 1} to {first + len(part)} of {len(jobs)}: {last}"
            ) from None
    while running:
        left = []
        for job, handle in running:
            if handle.done():
                yield _answer(job, handle)
            else:
                left.append((job, handle))
        running = left
        if running:
            time.sleep(_POLL_S)


def executor_of(options: Options, logs: Path) -> submitit.AutoExecutor:
    """submitit's executor with what a job may use.

    Raises:
      ValueError: this machine has no `sbatch`.
    """
    try:
        executor = submitit.AutoExecutor(logs, options.executor, slurm_max_num_timeout=options.retries)
    except RuntimeError as error:
        raise ValueError(
            f"--runner slurm needs a machine that submits to Slurm, and this one does not ({error})"
        ) from None
    executor.update_parameters(
        name="mpge",
        timeout_min=math.ceil(60 * options.hours),
        cpus_per_task=options.cpus,
        gpus_per_node=options.gpus,
        **({} if options.memory_gb is None else {"mem_gb": options.memory_gb}),
        slurm_additional_parameters=dict(option.split("=", 1) for option in options.sbatch),
    )
    return executor


def _answer(job: Job, handle: Any) -> Ended:
    try:
        answer = handle.result()
    except Exception as error:
        # submitit raises errors of many kinds for jobs that ended without an answer.
        reason = f"Slurm lost it (job {handle.job_id}, {handle.state}; its log is {handle.paths.stderr})"
        return Ended(job.name, "failed", reason, str(error))
    assert isinstance(answer, Ended)
    return answer
