"""MCAP files by the writer of mcap-ros2-support."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats import tables
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.recordings.formats.logs import ROWS, motion, write_mcap


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_joint_states_and_commands_by_name(tmp_path, arm, compression):
    path = write_mcap(tmp_path / "run.mcap", compression)
    (found,) = load_recordings([path], *arm)
    m = motion()
    np.testing.assert_allclose(found.time - found.time[0], m["time"], atol=1e-9)
    for key in ("qpos", "qvel", "force", "ctrl"):
        np.testing.assert_allclose(getattr(found, key), m[key])


def test_a_file_that_was_cut_off_is_read_up_to_there(tmp_path, arm):
    path = write_mcap(tmp_path / "run.mcap", chunk=2000)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 6 // 10])
    (found,) = load_recordings([path], *arm)
    n = found.time.size
    assert 10 < n < ROWS
    np.testing.assert_allclose(found.qpos, motion()["qpos"][:n])
    assert any("ends in the middle of a record" in w for w in found.warnings)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_chunks_that_would_fill_the_memory_are_refused(tmp_path, arm, compression, monkeypatch):
    path = write_mcap(tmp_path / "run.mcap", compression)
    monkeypatch.setattr(tables, "MAX_BYTES", path.stat().st_size - 1000)
    with pytest.raises(InputError, match="unpacked"):
        load_recordings([path], *arm)


@pytest.mark.parametrize(("compression", "field"), [("lz4", b"lz4"), ("zstd", b"zstd")])
def test_chunks_larger_than_they_state_are_refused(tmp_path, arm, compression, field):
    """A chunk's header: start, end, unpacked size, CRC, name of the compression."""
    path = write_mcap(tmp_path / "run.mcap", compression)
    data = bytearray(path.read_bytes())
    at = data.index(field) - 4 - 4 - 8
    assert int.from_bytes(data[at : at + 8], "little") > 1000
    data[at : at + 8] = (100).to_bytes(8, "little")
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"unpacked|damaged"):
        load_recordings([path], *arm)
