"""A Ray cluster of two nodes on this machine, of which one is killed while both are at work.

A process of its own runs it: `python -c "from tests.experiments.runners import two_nodes; two_nodes.main(...)"`.
"""

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import ray
import tyro
from ray.cluster_utils import Cluster

from experiments import runners, sweep
from experiments.fleet import __main__ as fleet
from experiments.presets import PRESETS
from mpge_jax.rollouts import policies
from tests.experiments.fleet import small_fleet
from tests.experiments.runners.jobs import sums
from tests.experiments.test_sweep import shipped
from tests.experiments.tiny import TINY

SMALL = {"num_cpus": 1, "object_store_memory": 80_000_000, "include_dashboard": False}
RAY = runners.Options(runner="ray")


def in_the_middle_of_jobs(out: Path) -> bool:
    """Whether two jobs have ended, and each node is at one."""
    begun, ended = (set(_lines(out / f"{name}.txt")) for name in ("begun", "ended"))
    return len(ended) >= 2 and len(begun - ended) == 2


def _lines(path: Path) -> list[str]:
    return path.read_text().split() if path.exists() else []


def in_the_middle_of_cells(out: Path) -> bool:
    """Whether each node is at a cell, and one has recorded its logs."""
    cells = [path.parent for path in (out / "cells").glob("*/.lock")]
    return len(cells) == 2 and any(list(cell.glob("target_log_*.npz")) for cell in cells)


def killing_a_node(work: Callable[[], None], when: Callable[[], bool]) -> None:
    """Does `work` with Ray connected to two nodes, one of which is killed as soon as `when` says so."""
    cluster = Cluster(initialize_head=True, head_node_args=SMALL)
    second = cluster.add_node(**SMALL)
    ray.init(address=cluster.address, log_to_driver=False)
    killed = []

    def kill() -> None:
        while not when():
            time.sleep(0.02)
        cluster.remove_node(second, allow_graceful=False)
        killed.append(second)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    try:
        work()
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert killed, "all was done before a node was killed"


def add_sums(out: Path) -> None:
    """Six jobs of two seconds."""
    jobs = sums(out, 6, **{f"job_{n}": {"seconds": 2.0} for n in range(6)})
    ended = list(runners.run(jobs, RAY, out / "logs"))
    assert all(e.state in ("done", "before") for e in ended), ended
    assert sorted(e.name for e in ended) == sorted(job.name for job in jobs)


def tiny_cell(given: sweep.CellJob) -> None:
    """A cell from small untrained policies; the work of a job."""
    policies.shipped = shipped
    REAL(given)


REAL = sweep.run_cell


def run_cells(out: Path, options: runners.Options) -> None:
    """Three cells of the sweep on the tiny preset."""
    PRESETS["tiny"], sweep.run_cell = TINY, tiny_cell
    asked = {"method": ("direct", "GAT", "SPG"), "samples": (11,), "preset": "tiny", "backend": "c"}
    assert sweep.sweep(sweep.Args(**asked, out=out, quiet=True, options=options)) == 0


def in_the_middle_of_robots(out: Path) -> bool:
    """Whether each node is at a robot."""
    return len(list((out / "out" / "robots").glob("*/.lock"))) == 2


def run_fleet(out: Path, *more: str) -> None:
    """The robots of the small fleet, whose recordings lie in `given`."""
    options = [*small_fleet.options(out.parent / "given"), "--out", str(out / "out"), *more]
    assert fleet.fleet(tyro.cli(fleet.Args, args=options)) == 0


def main(what: str, out: str) -> None:
    """Does one of the above."""
    folder = Path(out)
    if what == "sums":
        killing_a_node(lambda: add_sums(folder), lambda: in_the_middle_of_jobs(folder))
    elif what == "cells":
        killing_a_node(lambda: run_cells(folder, RAY), lambda: in_the_middle_of_cells(folder))
    elif what == "fleet":
        killing_a_node(lambda: run_fleet(folder, "--runner", "ray"), lambda: in_the_middle_of_robots(folder))
    elif what == "fleet alone":
        run_fleet(folder)
    else:
        run_cells(folder, runners.Options())
    sys.exit(0)
