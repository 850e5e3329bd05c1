"""Diagnoses and sweeps killed at random moments end with the results of those that were not."""

import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.machines import PENDULUM, record

ROOT = Path(__file__).resolve().parents[2]
Start = Callable[[Path], subprocess.Popen[bytes]]


def start(*command: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, *command],
        cwd=ROOT,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def kill_often(begin: Start, folder: Path, kills: int, same: Callable[[Path, Path], None]) -> None:
    """Kills runs into one folder at random moments of what a whole run takes, and has them go on."""
    started = time.monotonic()
    assert begin(folder / "whole").wait() == 0
    duration = time.monotonic() - started
    out, rng = folder / "killed", random.Random()
    for kill in range(kills):
        process, delay = begin(out), rng.uniform(0.05, 1.0) * duration
        print(f"kill {kill} after {delay:.2f} of {duration:.2f} s")
        try:
            assert process.wait(delay) == 0
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            continue
        # It was done before: its results count, and the next ones start anew.
        same(folder / "whole", out)
        shutil.rmtree(out)
    assert begin(out).wait() == 0
    same(folder / "whole", out)


def diagnoses(folder: Path) -> Start:
    def friction(_model, data):
        data.qfrc_applied[0] -= 0.1 * np.tanh(data.qvel[0] / 0.03)

    (folder / "model.xml").write_text(PENDULUM)
    for r in record(PENDULUM, 1.2, force=friction):
        np.savez(folder / f"{r.name}.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    options = ["--model", str(folder / "model.xml"), "--recordings", str(folder), "--jobs", "1"]
    options += ["--effects", "coulomb_friction", "viscous_damping", "armature", "--out"]
    return lambda out: start("-m", "experiments.diagnose", *options, str(out))


def same_diagnosis(a: Path, b: Path) -> None:
    for name in ("diagnosis.json", "effects.json", "corrected.xml", "corrected.yaml", "corrected.patch"):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    # Nothing of a search is left over, nor of a file half written.
    assert sorted(p.name for p in a.rglob("*")) == sorted(p.name for p in b.rglob("*"))


def sweeps() -> Start:
    code = "from tests.experiments import test_sweep; test_sweep.tiny_main()"
    options = ["--preset", "tiny", "--method", "MPGE+", "--samples", "11", "--quiet", "--out"]
    return lambda out: start("-c", code, *options, str(out))


def same_sweep(a: Path, b: Path) -> None:
    rows = [json.loads((out / "results.json").read_text())["rows"] for out in (a, b)]
    for found in rows:
        for row in found:
            del row["seconds"], row["grounding_seconds"]
    assert rows[0] == rows[1] and len(rows[0]) == 2
    for name in ("transformers.npz", "curve.npz"):
        with np.load(a / "cells/MPGE+-11" / name) as x, np.load(b / "cells/MPGE+-11" / name) as y:
            assert x.files == y.files
            for key in x.files:
                np.testing.assert_array_equal(x[key], y[key])


@pytest.mark.slow
def test_diagnoses_killed_often(tmp_path):
    kill_often(diagnoses(tmp_path), tmp_path, 25, same_diagnosis)


@pytest.mark.slow
def test_sweeps_killed_often(tmp_path):
    kill_often(sweeps(), tmp_path, 25, same_sweep)
