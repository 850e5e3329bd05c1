"""LeRobot folders, as pyarrow writes them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats import lerobot
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.recordings.formats.logs import ROWS, motion, write_lerobot

NAMES = ["shoulder.pos", "elbow.pos"]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("names", [NAMES, {"motors": NAMES}, ["motor_0", "motor_1"], None])
def test_every_episode_is_a_recording(tmp_path, arm, version, names):
    folder = write_lerobot(tmp_path / "so100", version, names)
    found = load_recordings([folder], *arm)
    assert [r.name for r in found] == ["so100_0", "so100_1"]
    for k, r in enumerate(found):
        np.testing.assert_allclose(r.qpos, motion()["qpos"] + k, atol=1e-6)
        np.testing.assert_allclose(r.ctrl, motion()["ctrl"], atol=1e-6)
        np.testing.assert_allclose(r.time, np.arange(ROWS) / 50, atol=1e-12)


def test_names_decide_and_not_the_order(tmp_path, arm):
    (first, _) = load_recordings([write_lerobot(tmp_path / "d", 3, NAMES[::-1])], *arm)
    np.testing.assert_allclose(first.qpos, motion()["qpos"][:, ::-1], atol=1e-6)
    with pytest.raises(
        InputError, match=r"nothing .* recognised as positions.*observation.state \[hand_x, hand_y\]"
    ):
        load_recordings([write_lerobot(tmp_path / "hand", 3, ["hand_x", "hand_y"])], *arm)


def test_times_that_a_recorder_made_up_are_told_as_such(tmp_path, arm):
    (made_up, _) = load_recordings([write_lerobot(tmp_path / "a", 2, NAMES)], *arm)
    assert lerobot.SAID in "".join(made_up.warnings)
    assert "jitter" not in lerobot.SAID
    rng = np.random.default_rng(0)
    stamps = np.arange(ROWS) / 50 + rng.uniform(0, 0.005, ROWS)
    (measured, _) = load_recordings([write_lerobot(tmp_path / "b", 2, NAMES, stamps)], *arm)
    np.testing.assert_allclose(measured.time, stamps, atol=1e-6)
    assert lerobot.SAID not in "".join(measured.warnings)


def test_frames_are_put_in_their_order(tmp_path, arm):
    import pyarrow.parquet as pq

    folder = write_lerobot(tmp_path / "a", 3, NAMES)
    (file,) = folder.rglob("*.parquet")
    rows = np.random.default_rng(0).permutation(2 * ROWS)
    pq.write_table(pq.read_table(file).take(rows), file)
    for k, r in enumerate(load_recordings([folder], *arm)):
        np.testing.assert_allclose(r.qpos, motion()["qpos"] + k, atol=1e-6)


def test_info_leads_to_no_other_folder_and_is_checked(tmp_path, arm):
    folder = write_lerobot(tmp_path / "a", 2, NAMES)
    info = folder / "meta" / "info.json"
    assert "../../elsewhere" in info.read_text()
    for bad in ("{", "[]", json.dumps({"fps": 0, "features": {}}), json.dumps({"fps": 30}), "[" * 100_000):
        info.write_text(bad)
        with pytest.raises(InputError, match=r"info\.json is damaged"):
            load_recordings([folder], *arm)


def test_rows_of_unequal_lengths_are_refused(tmp_path, arm):
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder = write_lerobot(tmp_path / "a", 3, NAMES)
    (file,) = folder.rglob("*.parquet")
    pq.write_table(pa.table({"observation.state": [[1.0], [1.0, 2.0]], "episode_index": [0, 0]}), file)
    with pytest.raises(InputError, match="different numbers of values"):
        load_recordings([folder], *arm)


def test_sizes_are_read_before_the_numbers(tmp_path, arm, monkeypatch):
    folder = write_lerobot(tmp_path / "a", 3, NAMES)
    monkeypatch.setattr("mpge_jax.diagnosis.recordings.formats.tables.MAX_VALUES", 200)
    with pytest.raises(InputError, match="values; cut the recording"):
        load_recordings([folder], *arm)
