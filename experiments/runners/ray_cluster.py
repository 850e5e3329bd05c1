"""Jobs as tasks of a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import ray

from experiments.runners.job import Ended, Job, perform
from experiments.runners.options import AHEAD, Options


def run(jobs: Sequence[Job], options: Options, logs: Path) -> Iterator[Ended]:
    """Runs jobs, which end in any order. One whose machine or process is lost is started anew elsewhere."""
    here = not ray.is_initialized()
    if here:
        ray.init(address=options.address, log_to_driver=False, logging_level=logging.ERROR)
    memory = None if options.memory_gb is None else int(options.memory_gb * 1e9)
    task = ray.remote(perform).options(
        num_cpus=options.cpus, num_gpus=options.gpus, memory=memory, max_retries=options.retries
    )
    rest, running = iter(jobs), dict[Any, Job]()
    try:
        while True:
            for job in islice(rest, AHEAD - len(running)):
                running[task.remote(job)] = job
            if not running:
                return
            ended, _ = ray.wait(list(running), num_returns=1)
            for each in ended:
                yield _answer(each, running.pop(each), options)
    finally:
        for each in running:
            ray.cancel(each, force=True)
        if here:
            ray.shutdown()


def _answer(task: Any, job: Job, options: Options) -> Ended:
    try:
        answer = ray.get(task)
    except ray.exceptions.RayError as error:
        first = str(error).strip().partition("\n")[0]
        return Ended(
            job.name,
            "failed",
            f"Ray lost it, {options.retries} further tries included ({type(error).__name__}: {first})",
        )
    assert isinstance(answer, Ended)
    return answer
