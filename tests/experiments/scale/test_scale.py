"""Measuring what runs cost, and the page that says it."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from experiments.runners import Options
from experiments.scale import __main__ as command
from experiments.scale import costs, overheads, page
from experiments.scale.cost_model import fitted
from experiments.scale.costs import CellCost, Diagnosis
from experiments.scale.robots import Robots, write
from mpge_jax import files

ROOT = Path(__file__).resolve().parents[3]
ONE = Diagnosis(1, 30, 6_000, 90_000, 1, 20.0, 10.0, 100.0, 14, 400_000, "a machine")


def test_the_page_is_that_of_the_kept_measurements():
    text = page.markdown(ROOT / "docs" / "results" / "scale")
    assert (ROOT / "docs" / "scale.md").read_text() == text, "python -m experiments.scale page writes it anew"


def test_the_cost_model_by_hand():
    rows = [
        ONE,
        replace(ONE, rows=16_000, cpu_seconds=12.0, peak_mb=101.0),
        replace(ONE, joints=2, cpu_seconds=30.0),
        # Too little data to fill the windows of a search.
        replace(ONE, rows=600, cpu_seconds=3.0),
        replace(ONE, joints=3, rows=600),
    ]
    model = fitted(rows)
    # 2 s and 1 MB for 10,000 rows more; of 6,000 rows that is 1.2 s, of 6,000 rows of two joints 2.4 s.
    assert (model.per_row, model.mb_per_row) == pytest.approx((2e-4, 1e-4))
    assert model.search == pytest.approx({1: 8.8, 2: 27.6})
    assert model.cpu_seconds(2, 10_000) == pytest.approx(31.6)
    # More data that cost less is scatter.
    assert fitted([ONE, replace(ONE, rows=16_000, cpu_seconds=9.0)]).per_row == 0.0


def test_projections_follow_from_the_measurements(tmp_path):
    # 1,000 runs of 200 rows, as fast as the smallest: 10 s each.
    costs.add([ONE, replace(ONE, runs=1_000, rows=200_000, bytes=3_000_000)], tmp_path)
    text = page.markdown(tmp_path)
    # 10,000 x 10 s are 27.8 h; 10,000 x 3 MB are 30 GB, and 10,000 x 0.4 MB are 4 GB.
    assert "| 1 | 28 | 0 | 0.028 | 30 | 4 |" in text
    assert "(1,000 runs were measured with 1 joint)" in text and "10,000,000 files" in text
    with pytest.raises(FileNotFoundError, match="nothing was measured yet"):
        page.markdown(tmp_path / "nowhere")


def test_robots_are_made_as_asked_and_again_the_same(tmp_path):
    asked = Robots(joints=2, count=2, runs=2, seconds=0.5)
    for folder in (tmp_path / "a", tmp_path / "b"):
        write(asked, folder)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a" / "model.xml"))
    assert (model.nv, model.nu) == (2, 2)
    recordings = sorted((tmp_path / "a").rglob("*.npz"))
    assert len(recordings) == 4
    for path in recordings:
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()
        with np.load(path) as data:
            assert data["qpos"].shape == data["ctrl"].shape == (51, 2)
            np.testing.assert_allclose(np.diff(data["time"]), 0.01)
            assert data["qpos"].std(0).min() > 0.01
    with pytest.raises(ValueError, match="--joints must be at least 1, got 0"):
        Robots(joints=0)


def test_what_runs_took_is_read_from_their_folders(tmp_path, capsys):
    write(Robots(joints=1, runs=2, seconds=0.5), tmp_path / "big")
    out = tmp_path / "big" / "fleet" / "robots" / "robot_0"
    files.write_text(out / "cost.json", json.dumps({"seconds": 3.0, "cpu_seconds": 2.0, "peak_mb": 90.0}))
    files.write_text(out / "effects.json", json.dumps({"effects": [{}, {}]}))
    kept = tmp_path / "kept"
    for _ in range(2):
        assert command.main(["fleet", str(tmp_path / "big"), "--kept", str(kept)]) == 0
    (row,) = costs.read(Diagnosis, kept)
    assert (row.joints, row.runs, row.rows, row.effects, row.files) == (1, 2, 102, 2, 2)
    assert (row.seconds, row.cpu_seconds, row.peak_mb) == (3.0, 2.0, 90.0)
    assert (
        command.main(["sweep", str(ROOT / "docs/results/SkewedPendulum-standard"), "--kept", str(kept)]) == 0
    )
    cells = {(cell.method, cell.samples): cell for cell in costs.read(CellCost, kept)}
    # Three seeds' shares of 397.1 s.
    spg = cells["SPG", 500]
    assert spg.seconds == pytest.approx(1191.3) and np.isnan(spg.cpu_seconds)
    assert command.main(["fleet", str(tmp_path), "--kept", str(kept)]) == 2
    assert "scale: " in capsys.readouterr().err


def test_overheads_are_measured():
    jobs = overheads.measure_jobs(3, Options())
    assert (jobs.runner, jobs.workers, jobs.jobs) == ("local", 1, 3) and jobs.seconds >= 0
    found = overheads.measure_comparison(12)
    assert found.robots == 12 and found.peak_mb > 1
