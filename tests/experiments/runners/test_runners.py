"""Where jobs run: what every runner keeps to, and this machine's own."""

import json

import pytest

from experiments import runners
from experiments.runners import Options
from mpge_jax import files
from tests.experiments.runners.jobs import results_of, sums

TWO = Options(workers=2)


def told(folder, name: str) -> list[str]:
    return sorted((folder / f"{name}.txt").read_text().split())


def test_jobs_are_done_once_and_in_order(tmp_path):
    jobs = sums(tmp_path, 3)
    assert [e.name for e in runners.run(jobs, Options(), tmp_path / "logs")] == ["job_0", "job_1", "job_2"]
    # 1 + ... + 10 and 1 + ... + 20
    assert [(tmp_path / f"job_{n}" / "sum.txt").read_text() for n in range(3)] == ["0\n", "55\n", "210\n"]
    cost = json.loads((tmp_path / "job_1" / "cost.json").read_text())
    assert set(cost) == {"seconds", "cpu_seconds", "peak_mb"} and 1 < cost["peak_mb"] < 1e5
    (tmp_path / "job_1" / "sum.txt").unlink()
    again = list(runners.run(jobs, Options(), tmp_path / "logs"))
    assert [(e.name, e.state) for e in again] == [
        ("job_0", "before"),
        ("job_2", "before"),
        ("job_1", "done"),
    ]
    assert told(tmp_path, "begun") == ["job_0", "job_1", "job_1", "job_2"]
    assert not list(tmp_path.rglob(".lock"))


def test_jobs_that_fail_are_told_in_a_line_and_stop_no_other(tmp_path):
    wrong = {"job_0": {"how": "raises"}, "job_1": {"how": "refuses"}, "job_2": {"how": "forgets"}}
    ended = {e.name: e for e in runners.run(sums(tmp_path, 4, **wrong), Options(), tmp_path)}
    assert ended["job_0"].reason == "FloatingPointError: it diverged"
    assert "a thousand lines" in ended["job_0"].details
    assert ended["job_1"].reason == "run_3.npz: time does not increase; sort its rows."
    assert ended["job_2"].reason.startswith("it ended without its result")
    assert [ended[f"job_{n}"].state for n in range(4)] == ["failed"] * 3 + ["done"]


def test_several_processes_write_the_same_bytes_and_survive_the_death_of_one(tmp_path):
    alone, several = tmp_path / "alone", tmp_path / "several"
    dies = {"job_1": {"how": "dies"}}
    for folder in (alone, several):
        folder.mkdir()
    assert {e.state for e in runners.run(sums(alone, 3), Options(), alone)} == {"done"}
    ended = {e.name: e for e in runners.run(sums(several, 3, **dies), TWO, several)}
    assert ended["job_1"].reason == (
        "its process was ended by SIGKILL, as the system does where memory runs out"
    )
    assert told(several, "ended") == ["job_0", "job_2"]
    # The dead one's folder is free again.
    assert [e.state for e in runners.run(sums(several, 3), Options(), several)] == [
        "before",
        "before",
        "done",
    ]
    assert results_of(several) == results_of(alone) and len(results_of(alone)) == 3


def test_a_job_that_another_process_does_is_waited_for_and_not_done_twice(tmp_path, monkeypatch):
    (job,) = sums(tmp_path, 1)
    with files.held(job.result.parent):
        other = files.held(job.result.parent)
        with pytest.raises(files.FolderInUse):
            other.__enter__()
        waited = []

        def end_of_the_other(seconds):
            waited.append(seconds)
            files.write_text(job.result, "by the other\n")
            (job.result.parent / ".lock").unlink()

        monkeypatch.setattr("experiments.runners.job.time.sleep", end_of_the_other)
        assert runners.job.perform(job).state == "before"
    assert len(waited) == 1 and job.result.read_text() == "by the other\n"
    assert not (tmp_path / "begun.txt").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "--workers must be at least 1, got 0"),
        ({"retries": -1}, "--retries must be at least 0, got -1"),
        ({"hours": 0.0}, "--hours must be more than 0, got 0.0"),
        ({"memory_gb": -1.0}, "--memory-gb must be more than 0, got -1.0"),
        ({"sbatch": ("partition",)}, "--sbatch partition is not of the form NAME=VALUE"),
    ],
)
def test_options_are_validated(options, message):
    with pytest.raises(ValueError, match=message):
        Options(**options)


@pytest.mark.parametrize(("runner", "package"), [("ray", "ray"), ("slurm", "submitit")])
def test_a_missing_package_is_named_with_the_line_that_installs_it(monkeypatch, tmp_path, runner, package):
    monkeypatch.setattr("experiments.runners.dispatch.find_spec", lambda name: None)
    said = rf"--runner {runner} needs {package}, which is not installed: pip install 'mpge-jax\[{runner}\]'"
    with pytest.raises(ValueError, match=said):
        runners.run(sums(tmp_path, 1), Options(runner=runner), tmp_path)
    runners.check(Options())


def test_two_jobs_in_one_folder_are_refused(tmp_path):
    with pytest.raises(ValueError, match="two jobs have the name job_0"):
        runners.run([*sums(tmp_path, 2), *sums(tmp_path, 1)], Options(), tmp_path)
