"""Jobs on this machine: in this process, or each in a process of its own, several at a time."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from experiments.runners.job import Ended, Job, perform
from experiments.runners.options import Options


def run(jobs: Sequence[Job], options: Options, logs: Path) -> Iterator[Ended]:
    """Runs jobs in their order; with several workers they end in any order."""
    if options.in_this_process:
        yield from map(perform, jobs)
        return
    # One process a job: what one leaves in memory, and what ends it, is no other's.
    spawn, waiting = multiprocessing.get_context("spawn"), deque(jobs)
    running: dict[Connection, tuple[SpawnProcess, Job]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < options.workers:
                here, there = spawn.Pipe(duplex=False)
                process = spawn.Process(target=_work, args=(waiting[0], there))
                process.start()
                there.close()
                running[here] = process, waiting.popleft()
            for each in wait(list(running)):
                assert isinstance(each, Connection)
                process, job = running.pop(each)
                with each:
                    try:
                        ended = each.recv()
                    except EOFError:
                        ended = None
                process.join()
                yield ended or Ended(job.name, "failed", _end_of(process))
    finally:
        for process, _ in running.values():
            process.kill()
            process.join()


def _work(job: Job, answer: Connection) -> None:
    # Ctrl-C goes to all processes of a terminal: the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with answer:
        answer.send(perform(job))


def _end_of(process: SpawnProcess) -> str:
    code = process.exitcode or 0
    if code >= 0:
        return f"its process ended with status {code} and said nothing"
    name = signal.Signals(-code).name
    hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"
