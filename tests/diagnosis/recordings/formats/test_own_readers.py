"""Readers of a user's own, from a file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from experiments.inspect import main
from mpge_jax import own_code
from mpge_jax.diagnosis import InputError, load_readers
from mpge_jax.diagnosis.recordings.formats import own_readers, registry
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.machines import ARM
from tests.diagnosis.recordings.formats.logs import motion

DOCUMENTATION = (Path(__file__).parents[4] / "docs" / "diagnosis.md").read_text()
(FIRMWARE,) = re.findall(r"```python\n([^`]*register_reader[^`]*?)```", DOCUMENTATION)
ROW = np.dtype([("ms", "<u4"), ("angle", "<f4", 2), ("told", "<f4", 2)])
HEAD = "from mpge_jax.diagnosis import Column, Log, Table, register_reader\n\n"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A file of readers and a log of the arm that they read; what is registered ends with the test."""
    monkeypatch.setattr(registry, "OWN", before := [])
    monkeypatch.setattr(own_readers, "OWN", before)
    monkeypatch.setattr(own_readers, "_read", {})
    monkeypatch.setattr(own_code, "_loaded", {})
    m, rows = motion(), np.zeros(60, ROW)
    rows["ms"], rows["angle"], rows["told"] = np.round(1000 * m["time"]), m["qpos"], m["ctrl"]
    rows.tofile(tmp_path / "run.trc")
    (tmp_path / "firmware.py").write_text(FIRMWARE)
    return tmp_path


def test_the_documented_reader_gives_recordings_as_any_other(own, arm):
    assert load_readers(own / "firmware.py") == load_readers(own / "firmware.py") == ("firmware",)
    (found,) = load_recordings([own / "run.trc"], *arm)
    m = motion()
    for name in ("time", "qpos", "ctrl"):
        np.testing.assert_allclose(getattr(found, name), m[name], atol=1e-6, err_msg=name)
    # A folder's logs are known by their ending; its other files are left alone.
    assert [r.name for r in load_recordings([own], *arm)] == ["run"]


def test_commands_take_the_file(own, capsys):
    (own / "arm.xml").write_text(ARM)
    command = [str(own / "run.trc"), "--model", str(own / "arm.xml"), "--out", str(own / "looked")]
    assert main(command) == 2
    assert "run.trc is neither .npz nor .csv nor" in capsys.readouterr().err
    assert main([*command, "--reader-file", str(own / "firmware.py")]) == 0
    said = capsys.readouterr().out
    assert "firmware" in said and f"--reader-file {own / 'firmware.py'}" in said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "does not exist; give the path of a Python file."),
        ("x = 1", "registers no reader; put @register_reader("),
        (HEAD + "@register_reader('a', '.BAG')\ndef read(path): ...", "an ending is like '.log7'"),
        (HEAD + "@register_reader('a', '.csv')\ndef read(path): ...", "end in .csv are read already"),
        (
            HEAD + "@register_reader('a', '.bag')\ndef read(path): ...",
            "end in .bag are read already (ROS bag)",
        ),
        (
            HEAD + "@register_reader('HDF5', '.x')\ndef read(path): ...",
            "a reader named 'HDF5' exists already",
        ),
        (FIRMWARE + "\n1 / 0\n", "cannot be used: ZeroDivisionError in line"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence_and_changes_nothing(own, text, message):
    path = own / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as error:
        load_readers(path)
    said = str(error.value)
    assert message in said and said.endswith(".") and "\n" not in said
    assert registry.OWN == []


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return None", "the reader 'mine' must return a list of Log, at least one; it returned nothing."),
        ("return []", "it returned an empty list."),
        ("return [Log('a', (3,))]", "the tables of a must be Table, not int."),
        ("return [Log('a', (Table('', ({},), None, ''),))]", "a table's columns must be Column, not dict."),
        (
            "return [Log('a', (Table('', (Column('q', ['x']),), None, ''),))]",
            "'q' does not hold numbers but list.",
        ),
        ("return [Log('a', (Table('', (Column('q', [1.0]),), [0, 1], ''),))]", "have [1, 2] rows"),
        ("return [Log('a', (Table('', (Column('q', [1.0], ('x', 'y')),), None, ''),))]", "2 names of parts"),
        (
            "raise RuntimeError('no\\nmagic')",
            "the reader 'mine' failed with RuntimeError in line 5 of mine.py: no magic.",
        ),
    ],
)
def test_a_reader_that_gives_something_else_is_told_in_one_sentence(own, arm, body, message):
    (own / "mine.py").write_text(f"{HEAD}@register_reader('mine', '.trc')\ndef read(path):\n    {body}\n")
    load_readers(own / "mine.py")
    with pytest.raises(InputError) as error:
        load_recordings([own / "run.trc"], *arm)
    assert message in str(error.value) and "\n" not in str(error.value)
