"""docs/gpu.md, and what it says of runs."""

import copy
import json
from pathlib import Path

import pytest

from experiments.benchmark import gpu

ROOT = Path(__file__).resolve().parents[3]
KEPT = sorted((ROOT / "docs" / "results" / "gpu").glob("*.json"))


def test_the_page_is_what_the_kept_runs_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "gpu.md"
    monkeypatch.setattr("sys.argv", ["gpu", *map(str, KEPT), "--out", str(out)])
    assert gpu.main() == 0
    assert out.read_text("utf-8") == (ROOT / "docs" / "gpu.md").read_text("utf-8")


def test_engines_are_compared_at_the_same_sizes() -> None:
    record = json.loads(KEPT[0].read_text("utf-8"))
    record["rows"] = [
        {"part": "envs", "backend": backend, "copies": copies, "rate": rate, "first_call_seconds": 1.0}
        for backend, copies, rate in (
            ("mjx", 8, 10.0),
            ("mjx", 16, 20.0),
            ("warp", 16, 50.0),
            ("warp", 32, 900.0),
        )
    ]
    assert "Warp makes 2.5 to 2.5 times the rate of environment steps that MJX" in gpu.page([record])


def test_runs_of_two_machines_are_refused() -> None:
    one = json.loads(KEPT[0].read_text("utf-8"))
    other = copy.deepcopy(one)
    other["versions"]["machine"] = "another"
    with pytest.raises(ValueError, match="give the runs of one machine, got those of 2"):
        gpu.page([one, other])
