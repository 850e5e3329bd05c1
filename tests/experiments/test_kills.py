"""Diagnoses, fleets, sweeps and trainings killed at random moments end with the results of those that were not."""

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.experiments.fleet import small_fleet

ROOT = Path(__file__).resolve().parents[2]
OFTEN = 50
"""Kills in the long tests; in the short ones there are `SELDOM`."""
SELDOM = 3
START = """
import json, os, signal, sys, time
{imports}
sys.argv = ["command", *{options!r}]
for line in sys.stdin:
    out, delay = json.loads(line)
    begun, child = time.monotonic(), os.fork()
    if child == 0:
        status = 1
        try:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1), os.dup2(null, 2)
            status = {run}
        finally:
            os._exit(status or 0)
    status = None
    while status is None:
        done, code = os.waitpid(child, os.WNOHANG)
        if done:
            status = os.waitstatus_to_exitcode(code)
        elif delay is not None and time.monotonic() - begun > delay:
            os.kill(child, signal.SIGKILL)
            delay = None
        else:
            time.sleep(0.002)
    print(json.dumps([status, time.monotonic() - begun]), flush=True)
"""
"""A process that has imported a command and runs it in copies of itself, which it kills after `delay` s."""
QUICK_FIGURES = """
from mpge_jax.diagnosis.report import folder
def draw(d, at):
    at.mkdir(exist_ok=True)
    shown = {name: at / f"{name}.png" for name in ("prediction", "errors", "residuals", "robot", "location")}
    for path in shown.values():
        path.write_bytes(b"drawn")
    return shown
folder.draw = draw
"""
"""Makes files of the figures of a report that cost nothing: in the short tests these would take as long as the rest."""


@contextmanager
def command(imports: str, options: list[str], run: str, programs: Path) -> Iterator[Callable[..., Any]]:
    """Runs a command whose output folder is `out`: `(folder, delay) -> (exit status, seconds)`."""
    code = START.format(imports=imports, options=options, run=run)
    flags = {"XLA_FLAGS": os.environ.get("XLA_FLAGS", ""), "JAX_PLATFORMS": "cpu"}
    # Pictures of machines take longer than what is killed here.
    flags |= {
        "MUJOCO_GL": "off",
        "JAX_COMPILATION_CACHE_DIR": str(programs),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.03",
    }
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, env={**os.environ, **flags}, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as server:  # fmt: skip

        def once(out: Path, delay: float | None = None) -> tuple[int, float]:
            assert server.stdin is not None and server.stdout is not None
            print(json.dumps([str(out), delay]), file=server.stdin, flush=True)
            return tuple(json.loads(server.stdout.readline()))

        try:
            yield once
        finally:
            server.kill()


def kill_often(
    once: Callable[..., Any], folder: Path, kills: int, same: Callable[[Path, Path], None]
) -> None:
    """Kills runs into one folder at random moments of what a whole run takes, and has them go on."""
    status, duration = once(folder / "whole")
    assert status == 0
    rng, killed, done = random.Random(), 0, 0
    deadline = time.monotonic() + 60.0 + 5.0 * kills * duration
    while killed < kills:
        assert time.monotonic() < deadline
        delay = rng.uniform(0.02, 1.0) * duration
        # a folder of its own after each that was done: workers that outlive a kill may still write there
        out = folder / f"killed_{done}"
        status, taken = once(out, delay)
        print(f"kill {killed} after {delay:.2f} of {duration:.2f} s: status {status}, {taken:.2f} s")
        if status == -9:
            killed += 1
            continue
        # It was done before: its results count, and the next ones start anew.
        assert status == 0
        same(folder / "whole", out)
        done += 1
    out = folder / f"killed_{done}"
    assert once(out)[0] == 0
    same(folder / "whole", out)


@contextmanager
def diagnoses(folder: Path, figures: str = "") -> Iterator[Callable[..., Any]]:
    small_fleet.make(folder / "given")
    robot = folder / "given" / "robots" / "left"
    options = ["--model", str(folder / "given" / "model.xml"), "--recordings", str(robot), "--jobs", "1"]
    options += ["--effects", "viscous_damping", "armature", "--quiet"]
    run = "diagnose.main([*sys.argv[1:], '--out', out])"
    with command("from experiments import diagnose" + figures, options, run, folder / "programs") as once:
        yield once


def same_diagnosis(a: Path, b: Path) -> None:
    names = (
        "diagnosis.json",
        "effects.json",
        "corrected.xml",
        "corrected.yaml",
        "corrected.patch",
        "corrected_env.py",
    )
    for name in names:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    left = [sorted(p.name for p in out.rglob("*")) for out in (a, b)]
    assert left[0] == left[1]
    assert [name for name in left[0] if name.startswith(".") or name.endswith(".partial")] == []


@contextmanager
def fleets(folder: Path, *more: str) -> Iterator[Callable[..., Any]]:
    options = [*small_fleet.make(folder / "given"), *more]
    run = "(sys.argv.extend(['--out', out]), fleet.main())[1]"
    imports = "from experiments.fleet import __main__ as fleet"
    with command(imports, options, run, folder / "programs") as once:
        yield once


def same_fleet(a: Path, b: Path) -> None:
    found = [small_fleet.results_of(out) for out in (a, b)]
    assert list(found[0]) == list(found[1])
    assert [name for name in found[0] if found[0][name] != found[1][name]] == []


@contextmanager
def sweeps(folder: Path, main: str, *chosen: str) -> Iterator[Callable[..., Any]]:
    options = ["--preset", "tiny", "--samples", "11", "--quiet", "--backend", "c", "--method", *chosen]
    imports = "from tests.experiments import test_sweep"
    with command(imports, options, f"test_sweep.{main}(out)", folder / "programs") as once:
        yield once


def same_sweep(a: Path, b: Path) -> None:
    rows = [json.loads((out / "results.json").read_text())["rows"] for out in (a, b)]
    for found in rows:
        for row in found:
            del row["seconds"], row["grounding_seconds"]
            row.pop("resumed", None)
    assert rows[0] == rows[1] and len(rows[0]) >= 2
    for file in a.glob("cells/*/*.npz"):
        same_arrays(file, b / file.relative_to(a))


def same_arrays(a: Path, b: Path) -> None:
    with np.load(a) as x, np.load(b) as y:
        assert x.files == y.files
        for key in x.files:
            # What is told beside the numbers has the time that a run took.
            if x[key].dtype.kind != "U":
                np.testing.assert_array_equal(x[key], y[key], err_msg=f"{a.name}: {key}")


@contextmanager
def trainings(folder: Path) -> Iterator[Callable[..., Any]]:
    imports = "from tests.experiments import test_pretrain"
    with command(imports, [], "test_pretrain.tiny_main(out)", folder / "programs") as once:
        yield once


def same_training(a: Path, b: Path) -> None:
    same_arrays(a / "InvertedPendulum-MS.npz", b / "InvertedPendulum-MS.npz")


def test_a_diagnosis_that_is_killed_goes_on(tmp_path):
    with diagnoses(tmp_path, QUICK_FIGURES) as once:
        kill_often(once, tmp_path, SELDOM, same_diagnosis)


def test_a_sweep_that_is_killed_goes_on(tmp_path):
    with sweeps(tmp_path, "faked_main", "direct", "GAT") as once:
        kill_often(once, tmp_path, SELDOM, same_sweep)


@pytest.mark.slow
def test_diagnoses_killed_often(tmp_path):
    with diagnoses(tmp_path) as once:
        kill_often(once, tmp_path, OFTEN, same_diagnosis)


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_fleets_killed_often(tmp_path, workers):
    """With workers of its own, these live on: what they are at is waited for and not done twice."""
    with fleets(tmp_path, "--workers", workers) as once:
        kill_often(once, tmp_path, OFTEN // 2, same_fleet)


@pytest.mark.slow
def test_sweeps_killed_often(tmp_path):
    with sweeps(tmp_path, "tiny_main", "MPGE+") as once:
        kill_often(once, tmp_path, OFTEN, same_sweep)


@pytest.mark.slow
def test_trainings_killed_often(tmp_path):
    with trainings(tmp_path) as once:
        kill_often(once, tmp_path, OFTEN, same_training)
