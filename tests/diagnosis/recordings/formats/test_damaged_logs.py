"""Any bytes give a recording or one sentence, from every reader; and a package that is missing is named."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import h5py
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats.registry import FORMATS
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.recordings.formats.logs import (
    arm_messages,
    motion,
    store,
    write_lerobot,
    write_mcap,
    write_ros1,
    write_ros2,
)

ROWS = 12
ENDINGS = [ending for f in FORMATS for ending in f.endings]


def _hdf5(folder: Path, packed: bool) -> Path:
    path, m = folder / "run.h5", motion(ROWS)
    with h5py.File(path, "w") as f:
        for key in ("time", "qpos", "ctrl"):
            f.create_dataset(f"data/demo_0/{key}", data=m[key], compression="gzip" if packed else None)
    return path


def _ros2(folder: Path) -> Path:
    return write_ros2(folder / "run", arm_messages(store(), rows=ROWS), store()) / "run.db3"


def _ros1(folder: Path, compress: str) -> Path:
    types = store(ros1=True)
    return write_ros1(folder / "run.bag", arm_messages(types, rows=ROWS, ros1=True), types, compress)


def _lerobot(folder: Path) -> Path:
    (path,) = write_lerobot(folder / "set", 3, None, episodes=1).rglob("*.parquet")
    return path


WRITERS = {
    "hdf5": lambda folder: _hdf5(folder, False),
    "hdf5, packed": lambda folder: _hdf5(folder, True),
    "ros2": _ros2,
    "ros1": lambda folder: _ros1(folder, ""),
    "ros1, bz2": lambda folder: _ros1(folder, "bz2"),
    "ros1, lz4": lambda folder: _ros1(folder, "lz4"),
    "mcap": lambda folder: write_mcap(folder / "run.mcap", "none", rows=ROWS),
    "mcap, lz4": lambda folder: write_mcap(folder / "run.mcap", "lz4", rows=ROWS),
    "mcap, zstd": lambda folder: write_mcap(folder / "run.mcap", "zstd", rows=ROWS),
    "lerobot": _lerobot,
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """File, what is given to the reader, and its bytes, by the way it was written."""
    out = {}
    for name, write in WRITERS.items():
        file = write(tmp_path_factory.mktemp("log"))
        out[name] = (file, file.parents[2] if name == "lerobot" else file, file.read_bytes())
    return out


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_logs_give_a_recording_or_one_sentence(logs, arm, capfd, name, data):
    file, path, whole = logs[name]
    damaged = bytearray(whole)
    for at in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=4)):
        damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    keep = data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))
    file.write_bytes(bytes(damaged[:keep]))
    try:
        found = load_recordings([path], *arm)
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 1500
    else:
        assert all(r.qpos.shape == (r.time.size, 2) for r in found)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("ending", ENDINGS)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300))
def test_any_bytes_are_refused_in_one_sentence(tmp_path, arm, ending, content):
    path = tmp_path / f"run{ending}"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"^cannot read run.*damaged or cut off") as caught:
        load_recordings([path], *arm)
    assert "\n" not in str(caught.value)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
FEATURE = st.dictionaries(st.sampled_from(["dtype", "shape", "names"]), JSON, max_size=3)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(fps=JSON, feature=FEATURE | JSON, rest=JSON)
def test_any_info_of_a_dataset_gives_recordings_or_one_sentence(logs, arm, fps, feature, rest):
    file, path, whole = logs["lerobot"]
    file.write_bytes(whole)
    info = path / "meta" / "info.json"
    before = info.read_text()
    for said in (
        {"fps": fps, "features": {}},
        {"fps": 50, "features": {"observation.state": feature, "x": rest}},
    ):
        info.write_text(json.dumps(said))
        try:
            assert all(r.qpos.shape == (r.time.size, 2) for r in load_recordings([path], *arm))
        except InputError as error:
            assert "\n" not in str(error)
    info.write_text(before)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(about=JSON, files=JSON, mode=JSON)
def test_any_metadata_of_a_bag_gives_a_recording_or_one_sentence(logs, arm, about, files, mode):
    file, _, whole = logs["ros2"]
    file.write_bytes(whole)
    metadata = file.parent / "metadata.yaml"
    known = {"relative_file_paths": files, "compression_mode": mode}
    for said in (about, {"rosbag2_bagfile_information": about}, {"rosbag2_bagfile_information": known}):
        metadata.write_text(json.dumps(said))
        try:
            (found,) = load_recordings([file.parent], *arm)
            assert found.qpos.shape == (ROWS, 2)
        except InputError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("name", "module", "line"),
    [
        ("hdf5", "h5py", "pip install h5py .*'h5'"),
        ("ros2", "rosbags.rosbag2", "pip install rosbags .*'ros'"),
        ("ros1", "rosbags.rosbag1", "pip install rosbags .*'ros'"),
        ("mcap", "mcap.stream_reader", "pip install mcap .*'mcap'"),
        ("mcap", "mcap_ros2.decoder", "pip install mcap-ros2-support .*'mcap'"),
        ("lerobot", "pyarrow.parquet", "pip install pyarrow .*'lerobot'"),
    ],
)
def test_a_missing_package_is_named(tmp_path, arm, monkeypatch, name, module, line):
    file = WRITERS[name](tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=line):
        load_recordings([file.parents[2] if name == "lerobot" else file], *arm)


def test_formats_are_told_apart_by_their_endings():
    assert len(set(ENDINGS)) == len(ENDINGS)
