"""Tuning: on tasks of its own, from a base, to what the presets have."""

import json
import subprocess

import pytest

import envs
from envs import registry
from experiments import paper, storage
from experiments.tuning import search as tuning

SOURCES = ("InvertedPendulum", "HalfCheetah")


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(registry, "_variants", dict(registry._variants))
    tuning.register()
    tuning.register()


def test_the_tuning_tasks_are_no_tasks_of_the_tables(registered):
    names = [variant.name for variant in tuning.VARIANTS]
    assert not set(names) & set(paper.TASKS)
    assert [envs.source_of(name) for name in names] == list(SOURCES)


@pytest.mark.parametrize("source", SOURCES)
def test_every_candidate_is_tried_once_and_the_presets_have_one_of_them(source):
    tried = tuning.tried(source)
    configs = [candidate.change(tuning.base(source)) for candidate in tried]
    assert all(a != b for i, a in enumerate(configs) for b in configs[:i])
    assert len({candidate.name for candidate in tried}) == len(tried)
    for method in ("MPG-MS", "Vine"):
        assert tuning.chosen(source, method) in configs
    for candidate, config in zip(tried, configs, strict=True):
        assert (config.branches > 1) == (candidate.method == "Vine")
        assert config.batch_size == 2048


def test_the_page_marks_what_the_presets_have(registered):
    def row(method, what, config):
        return {
            "task": "TuningPendulum", "method": method, "what": what, "iterations": 100, "simulator_steps": 204_800,
            "errors": {"0.25": [0.5, 0.7], "0.5": [0.3, 0.3], "1.0": [0.1, 0.2]},
            "config": json.loads(json.dumps(storage.plain(config))), "versions": {"machine": "a machine"},
        }  # fmt: skip

    rows = [
        row("MPG-MS", "base", tuning.base("InvertedPendulum")),
        row("MPG-MS", "D updates 24", tuning.chosen("InvertedPendulum", "MPG-MS")),
    ]
    page = tuning.markdown(rows)
    numbers = "100 | 204,800 | 0.600 (0.500 to 0.700) | 0.300 (0.300 to 0.300) | 0.150 (0.100 to 0.200) |"
    assert f"| MPG-MS | base | {numbers}" in page
    assert f"| MPG-MS | **D updates 24** | {numbers}" in page
    assert "a machine" in page


def test_a_result_names_its_commit(tmp_path):
    git = ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e"]
    assert storage.commit(tmp_path) == "none"
    subprocess.run([*git, "init", "-q"], check=True)
    (tmp_path / "a").write_text("1")
    subprocess.run([*git, "add", "a"], check=True)
    subprocess.run([*git, "commit", "-qm", "first"], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout
    assert len(storage.commit(tmp_path)) >= 12 and head.startswith(storage.commit(tmp_path))
    (tmp_path / "a").write_text("2")
    assert storage.commit(tmp_path).endswith("-dirty")


def test_one_task_alone_leaves_the_page_as_it_is(registered, tmp_path, monkeypatch, capsys):
    row = {
        "method": "MPG-MS", "what": "base", "iterations": 100, "simulator_steps": 1, "versions": {"machine": "m"},
        "errors": {"0.25": [0.5], "0.5": [0.3], "1.0": [0.1]}, "config": {},
    }  # fmt: skip
    page = tmp_path / "tuning.md"
    page.write_text("all of it")
    monkeypatch.setattr(tuning, "run", lambda task, candidate: {**row, "task": task})

    def command(*tasks):
        monkeypatch.setattr(
            "sys.argv", ["tuning", "--out", str(tmp_path), "--page", str(page), "--task", *tasks]
        )
        assert tuning.main() == 0
        return capsys.readouterr().out

    assert "TuningCheetah lacks results" in command("TuningPendulum") and page.read_text() == "all of it"
    assert "written: " in command("TuningCheetah")
    assert all(f"## {v.name}" in page.read_text() for v in tuning.VARIANTS)
