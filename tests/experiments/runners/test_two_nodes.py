"""Two Ray nodes, one of them killed at work: the results of a run that was not, nothing lost, nothing done twice."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from experiments import runners
from tests.experiments.fleet import small_fleet
from tests.experiments.runners.jobs import results_of, sums

pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[ray]'")
pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[3]


# Ray's workers give way to every other process of a machine unless told otherwise.
RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}


def do(what: str, out: Path) -> None:
    code = f"from tests.experiments.runners import two_nodes; two_nodes.main({what!r}, {str(out)!r})"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, "JAX_PLATFORMS": "cpu", **RAY},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_jobs_of_a_killed_node_are_done_elsewhere(tmp_path):
    alone, cluster = tmp_path / "alone", tmp_path / "cluster"
    for folder in (alone, cluster):
        folder.mkdir()
    list(runners.run(sums(alone, 6), runners.Options(), alone))
    do("sums", cluster)
    assert results_of(cluster) == results_of(alone) and len(results_of(alone)) == 6
    begun, ended = (Counter((cluster / f"{name}.txt").read_text().split()) for name in ("begun", "ended"))
    assert ended == Counter(f"job_{n}" for n in range(6))
    # What the killed node was at was begun again, and nothing else.
    assert sorted(begun.values()) == [1, 1, 1, 1, 1, 2]
    # Nothing is left to do.
    assert {e.state for e in runners.run(sums(cluster, 6), runners.Options(), cluster)} == {"before"}


def test_cells_of_a_killed_node_are_those_of_one_machine(tmp_path):
    do("cells alone", tmp_path / "alone")
    do("cells", tmp_path / "cluster")
    rows = []
    for out in (tmp_path / "alone", tmp_path / "cluster"):
        found = json.loads((out / "results.json").read_text())["rows"]
        # A commit while this test runs is no matter.
        rows.append([{k: v for k, v in row.items() if "seconds" not in k and k != "commit"} for row in found])
    assert rows[0] == rows[1] and len(rows[0]) == 6


def test_robots_of_a_killed_node_are_those_of_one_machine(tmp_path):
    small_fleet.make(tmp_path / "given")
    do("fleet alone", tmp_path / "alone")
    do("fleet", tmp_path / "cluster")
    alone, cluster = (small_fleet.results_of(tmp_path / name / "out") for name in ("alone", "cluster"))
    assert list(alone) == list(cluster) and "robots/right/diagnosis.json" in alone
    assert [name for name in alone if alone[name] != cluster[name]] == []
    files = sorted(p.relative_to(tmp_path / "alone") for p in (tmp_path / "alone" / "cells").rglob("*.npz"))
    assert files == sorted(
        p.relative_to(tmp_path / "cluster") for p in (tmp_path / "cluster" / "cells").rglob("*.npz")
    )
    for file in files:
        if file.name == "agents.npz":
            # Beside the agents it says how long they took.
            with np.load(tmp_path / "alone" / file) as a, np.load(tmp_path / "cluster" / file) as b:
                assert a.files == b.files
                for name in set(a.files) - {"about"}:
                    np.testing.assert_array_equal(a[name], b[name])
        else:
            assert (tmp_path / "alone" / file).read_bytes() == (tmp_path / "cluster" / file).read_bytes()
