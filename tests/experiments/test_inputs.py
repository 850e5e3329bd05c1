"""What cells start from, told by its contents."""

import dataclasses

import pytest

import envs
from envs import registry
from experiments.inputs import inputs_of
from experiments.methods import Cell, LogFiles, logged
from tests.experiments.tiny import TINY

OWN = '''"""A pendulum whose model lies beside this file, and a target of it."""
import dataclasses
import pathlib

import mujoco

import envs

XML = pathlib.Path(__file__).with_name("pole.xml")
POLE = dataclasses.replace(
    envs.make("InvertedPendulum", "c").task, name="XmlPole", spec=lambda: mujoco.MjSpec.from_file(str(XML))
)
WEAK = envs.Variant("WeakXmlPole", "XmlPole", "weak motor", action=lambda action, low, high: 0.5 * action)
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    for name in ("_tasks", "_variants", "_homes"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))
    xml = envs.make("InvertedPendulum", "c").task.spec().to_xml()
    (tmp_path / "pole.xml").write_text(xml)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path / "own.py"


def cell(task: str) -> Cell:
    preset = dataclasses.replace(
        TINY, tasks={name: TINY.tasks["InvertedPendulum"] for name in (*TINY.tasks, "XmlPole")}
    )
    return Cell(task, "direct", 0, (0,), preset, "c", "mujoco")


def test_the_model_beside_a_file_of_the_users_own_is_looked_at(own):
    before = inputs_of([cell(f"{own}:WeakXmlPole")])
    assert list(before) == ["the model of XmlPole", "the model of WeakXmlPole"]
    assert inputs_of([cell(f"{own}:WeakXmlPole")]) == before
    xml = own.with_name("pole.xml")
    xml.write_text(xml.read_text().replace("<option ", '<option wind="1 0 0" ', 1))
    after = inputs_of([cell(f"{own}:WeakXmlPole")])
    assert all(after[what] != checksum for what, checksum in before.items())


def test_shipped_tasks_are_told_by_the_commit():
    assert list(inputs_of([cell("BrokenHopper")])) == ["the MS policies of Hopper"]


def test_a_reader_is_part_of_the_log_that_it_reads(tmp_path):
    for name in ("log.csv", "reader.py"):
        (tmp_path / name).write_text(name)
    files = LogFiles((tmp_path / "log.csv",), readers=(tmp_path / "reader.py",))
    before = logged.fingerprint(files)
    (tmp_path / "reader.py").write_text("another")
    assert logged.fingerprint(files) != before
