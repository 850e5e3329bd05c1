"""What is spent beside the work: jobs that do nothing, and the comparison of a fleet that never ran."""

from __future__ import annotations

import json
import os
import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import runners
from experiments.fleet import page, picture, robot, table
from experiments.fleet.comparison import compare
from experiments.fleet.found import found_of
from experiments.scale.costs import Comparison, Jobs, machine
from mpge_jax import files


@dataclass(frozen=True)
class Nothing:
    """What a job that does nothing is given: the file that it writes."""

    result: Path


def do_nothing(given: Nothing) -> None:
    """Writes the result; the work of a job."""
    files.write_text(given.result, "")


def measure_jobs(count: int, options: runners.Options) -> Jobs:
    """Runs `count` jobs that do nothing, by the clock, the runner's own start among it.

    Raises:
      ValueError: one of them failed.
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        given = [Nothing(Path(folder) / f"job_{n}" / "result") for n in range(count)]
        jobs = [runners.Job(g.result.parent.name, do_nothing, g, g.result) for g in given]
        start = time.monotonic()
        for ended in runners.run(jobs, options, Path(folder) / "jobs"):
            if ended.state != "done":
                raise ValueError(f"{ended.name} failed: {ended.reason}")
        seconds = time.monotonic() - start
    name = options.runner if options.runner != "slurm" else f"slurm ({options.executor})"
    workers = options.workers if options.runner == "local" else 0
    return Jobs(name, workers, count, round(seconds, 2), round(os.getloadavg()[0], 1), machine())


def measure_comparison(robots: int, effects: int = 3) -> Comparison:
    """Writes diagnoses of robots that never were, then reads and compares them as a fleet does."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(robots):
            text = json.dumps(_diagnosis(rng, effects))
            files.write_text(folder / "robots" / f"robot_{number}" / robot.RESULT, text)
        start, begun = time.monotonic(), time.process_time()
        paths = [folder / "robots" / f"robot_{n}" / robot.RESULT for n in range(robots)]
        jobs = [runners.Job(path.parent.name, do_nothing, None, path) for path in paths]
        result = compare(found_of(robot.tables(jobs)[0]), {})
        drawn = picture.draw(result, folder / "fleet.png")
        files.write_text(folder / "fleet.md", page.markdown(result, None, True))
        files.write_text(folder / "fleet.html", page.html(result, None, drawn))
        files.write_text(folder / table.NAME, json.dumps(table.fleet_table(result, {}, None), indent=1))
        seconds, spent = time.monotonic() - start, time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-6
    return Comparison(robots, effects, round(seconds, 2), round(spent, 2), round(peak, 1), machine())


def _diagnosis(rng: np.random.Generator, effects: int) -> dict[str, object]:
    rows = []
    for k in range(effects):
        value = rng.normal(0.1, 0.003)
        entry = {"value": value, "low": value - 0.002, "high": value + 0.002, "unit": "N m"}
        rows.append({"id": "coulomb_friction", "at": f"joint_{k}", "parameters": {"torque": entry}})
    return {"verdict": "effects", "explanation": "", "effects": rows, "ambiguous": []}
