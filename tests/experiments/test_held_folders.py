"""Folders that one run holds."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mpge_jax import files

ROOT = Path(__file__).resolve().parents[2]


def holder(folder: Path) -> subprocess.Popen[str]:
    """Another process that holds a folder until it is killed."""
    code = f"from mpge_jax import files\nwith files.held({str(folder)!r}):\n    print('held', flush=True)\n    input()"
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_a_folder_is_held_by_one_run_until_it_is_killed(tmp_path):
    process = holder(tmp_path)
    refused = pytest.raises(
        files.FolderInUse, match=rf"in use by another run \(process {process.pid}\): wait"
    )
    with refused, files.held(tmp_path):
        pytest.fail("two runs hold it")
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdin.close()
    process.stdout.close()
    assert (tmp_path / ".lock").exists()
    with files.held(tmp_path):
        assert (tmp_path / ".lock").read_text() == str(os.getpid())
    assert not (tmp_path / ".lock").exists()


def test_what_is_left_empty_is_taken_away_again(tmp_path):
    with files.held(tmp_path / "a" / "b"):
        pass
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "kept").mkdir()
    with files.held(tmp_path / "kept"), pytest.raises(files.FolderInUse), files.held(tmp_path / "kept"):
        pass
    with files.held(tmp_path / "c"):
        (tmp_path / "c" / "result").write_text("")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c", "kept"]
