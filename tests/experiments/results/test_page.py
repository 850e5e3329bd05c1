"""The page of results says what the folders hold, and nothing else."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import report
from experiments.presets import QUICK
from experiments.results import page as results
from experiments.storage import SweepFolder, plain

IDENTITY = plain(
    {"task": "SkewedPendulum", "seeds": 2, "preset": QUICK, "backend": "c", "dynamics": "mujoco"}
)


def row(method: str, samples: int, seed: int, value: float, **more: float) -> dict:
    return {
        "task": "SkewedPendulum",
        "method": method,
        "samples": samples,
        "seed": seed,
        "target_steps": samples,
        "return_stochastic": value,
        "return_deterministic": value + 1,
        "seconds": 30.0,
        "grounding_seconds": 12.0 if samples else 0.0,
        **more,
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sweep of two methods, one of which failed at 500 samples."""
    path = tmp_path / "pendulum"
    sweep = SweepFolder(path, IDENTITY)
    cells = {
        ("direct", 0): [row("direct", 0, seed, 10.0 * seed) for seed in range(2)],
        ("SPG", 1000): [
            row(
                "SPG",
                1000,
                seed,
                800.0 + 100 * seed,
                transform_error=0.25,
                grounding_simulator_steps=41_472,
            )
            for seed in range(2)
        ],
    }
    for (method, samples), rows in cells.items():
        cell = sweep.cell(method, samples)
        cell.mkdir(parents=True)
        (cell / "result.json").write_text(json.dumps(rows))
    uniform = np.linspace(1.0, 0.05, 20)[:, None, None] * np.ones((20, 2, 1))
    np.savez(sweep.cell("SPG", 1000) / "curve.npz", error_uniform=uniform, error_own=2 * uniform)
    sweep.save_error("SPG", 500, "Traceback ...\nValueError: nothing was recorded\n  more: of it\n")
    sweep.write_tables("")
    (path / "errors.png").write_bytes(b"a picture")
    return path


def test_a_sweep_is_reported_with_its_command_and_numbers(folder: Path, tmp_path: Path) -> None:
    text = results.page(results.Args((folder,), tmp_path / "docs" / "results.md"))
    assert (
        "`python -m experiments.sweep --task SkewedPendulum --method direct SPG --samples 1000 --seeds 2 "
        "--preset quick --backend c`"
    ) in text
    assert "| direct | - | 2 | 5 ± 7 | -59 to 69 | 6 ± 7 | 34 |  | 0 |  |" in text
    assert (
        "| SPG | 1000 | 2 | 850 ± 71 | 215 to 1485 | 851 ± 71 | 293 | 0.250 ± 0.000 | 1,000 | 41,472 |"
        in text
    )
    assert "SPG-500 failed: ValueError: nothing was recorded" in text
    assert "direct 1.0; SPG at 1,000 1.0 (grounding 0.4)." in text
    # Shares of 20 iterations: the 1st, 2nd, 5th, 10th and 20th, at 0.95 / 19 = 0.05 less each.
    wanted = (
        "| SPG | 1,000 | 20 | 1.000 / 2.000 | 0.950 / 1.900 | 0.800 / 1.600 | 0.550 / 1.100 | 0.050 / 0.100 |"
    )
    assert wanted in text
    grounding = QUICK.tasks["InvertedPendulum"].grounding
    assert f"{grounding.iterations:,} grounding iterations of {grounding.batch_size:,} transitions" in text


def test_times_of_cells_that_were_interrupted_are_told_as_such(folder: Path, tmp_path: Path) -> None:
    path = SweepFolder(folder, IDENTITY).result("SPG", 1000)
    path.write_text(json.dumps([{**row, "resumed": True} for row in json.loads(path.read_text())]))
    SweepFolder(folder, IDENTITY).write_tables("")
    text = results.page(results.Args((folder,), tmp_path / "docs" / "results.md"))
    assert "direct 1.0; SPG at 1,000 1.0 (grounding 0.4) since it was interrupted." in text


def test_pictures_lie_beside_the_page(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the returns is of the rows that the page shows, also where more were run after the sweep drew its own."""
    drawn = []
    monkeypatch.setattr(report, "returns_figure", lambda rows, path, task: drawn.append((rows, path, task)))
    page = tmp_path / "docs" / "results.md"
    text = results.page(results.Args((folder,), page))
    images = page.parent / "images"
    assert [text.count(f"(images/pendulum-{name}.png)") for name in ("returns", "errors", "heat_map")] == [
        1,
        1,
        0,
    ]
    assert (images / "pendulum-errors.png").read_bytes() == b"a picture"
    ((rows, path, task),) = drawn
    assert (path, task) == (images / "pendulum-returns.png", "SkewedPendulum")
    assert {(row["method"], row["samples"]) for row in rows} == {("direct", 0), ("SPG", 1000)}


def test_shipped_policies_are_reported_with_their_returns() -> None:
    line = next(
        x for x in results.policies_section().splitlines() if x.startswith("| InvertedPendulum | MS |")
    )
    assert "| 5 | 1,000 (1,000 to 1,000) |" in line


def test_a_benchmark_is_included(tmp_path: Path) -> None:
    record = {
        "command": "python -m experiments.benchmark",
        "versions": {"machine": "some machine"},
        "load_average": [0.0, 0.0, 0.0],
        "rows": [
            {"part": "sac", "members": 1, "batch": 256, "rate": 123.4, "calls": 3, "first_call_seconds": 1.0}
        ],
    }
    (tmp_path / "benchmark.json").write_text(json.dumps(record))
    text = results.page(results.Args((tmp_path,), tmp_path / "docs" / "results.md"))
    assert "some machine" in text
    assert "| 1 | 256 | 123 |  |" in text


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["results", *arguments])
    return results.main()


@pytest.mark.parametrize("damage", ["empty folder", "broken json", "missing key", "broken curve"])
def test_what_cannot_be_read_is_refused_and_nothing_written(
    damage: str,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    chosen, said = folder, "results.json"
    if damage == "empty folder":
        chosen, said = tmp_path / "empty", "neither a sweep (results.json) nor a benchmark"
        chosen.mkdir()
    elif damage == "broken json":
        (folder / "results.json").write_text('{"identity": ')
    elif damage == "missing key":
        (folder / "results.json").write_text('{"rows": []}')
    else:
        (folder / "cells" / "SPG-1000" / "curve.npz").write_bytes(b"PK damaged")
        said = "curve.npz is damaged"
    page = tmp_path / "docs" / "results.md"
    assert run(monkeypatch, str(chosen), "--out", str(page)) == 2
    error = capsys.readouterr().err
    assert error.startswith("results: ")
    assert said in error
    assert error.count("\n") == 1
    assert not page.exists()


def test_two_folders_of_one_name_are_refused(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "elsewhere" / folder.name
    other.mkdir(parents=True)
    (other / "results.json").write_text((folder / "results.json").read_text())
    with pytest.raises(ValueError, match="two folders are called pendulum"):
        results.find((folder, other))


def test_no_folders_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="run `make sweep` first"):
        results.find(())


def test_cells_of_a_later_commit_or_of_another_machine_are_told(folder: Path, tmp_path: Path) -> None:
    record = json.loads((folder / "results.json").read_text())
    first, here = record["versions"]["commit"], record["versions"]["machine"]
    last = {name: record["rows"][-1][name] for name in ("method", "samples")}
    cell = f"{last['method']} at {last['samples']:,}" if last["samples"] else last["method"]
    plain = results.page(results.Args((folder,), tmp_path / "docs" / "results.md"))
    assert f"{here}; commit {first}, Python" in plain
    record["rows"] = [
        {**row, "commit": "0123abc", "machine": "a GPU"} if last.items() <= row.items() else row
        for row in record["rows"]
    ]
    (folder / "results.json").write_text(json.dumps(record))
    told = results.page(results.Args((folder,), tmp_path / "docs" / "results.md"))
    assert f"{here} ({cell}: a GPU); commit {first} ({cell}: 0123abc), Python" in told


def test_the_kept_results_give_the_page_that_the_project_shows(tmp_path: Path) -> None:
    """docs/results-standard.md from what docs/results holds, to the byte."""
    kept, shown = results.ROOT / "docs" / "results", results.ROOT / "docs" / "results-standard.md"
    folders = tuple(sorted(record.parent for record in kept.glob("*/results.json")))
    assert folders
    assert results.page(results.Args(folders, tmp_path / "docs" / shown.name)) == shown.read_text()
