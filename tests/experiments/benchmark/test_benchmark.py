"""The benchmark's arithmetic on made-up durations; that a measurement runs; and what it refuses."""

import re
from pathlib import Path

import jax
import pytest
import tyro

from experiments.benchmark import __main__ as benchmark
from experiments.benchmark import clock, simulation, table
from experiments.benchmark.__main__ import Args

ROOT = Path(__file__).resolve().parents[3]


def test_rate_is_amount_over_the_median_of_calls_after_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    # Start and end of each call: 50 s with the compilation, then 1, 4 and 2 s, median 2 s.
    times = iter([0.0, 50.0, 50.0, 51.0, 51.0, 55.0, 55.0, 57.0])
    monkeypatch.setattr(clock.time, "perf_counter", lambda: next(times))
    row = clock.measure(lambda: None, amount=300.0, seconds=5.0)
    assert row == {"rate": 150.0, "calls": 3, "first_call_seconds": 50.0}


def test_calls_go_on_for_the_time_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.0] * 2 + [0.0, 1.0] * 10)
    monkeypatch.setattr(clock.time, "perf_counter", lambda: next(times))
    assert clock.measure(lambda: None, amount=1.0, seconds=5.0)["calls"] == 5


def test_ratios_by_hand() -> None:
    rows = table.ratios(
        [
            {"part": "envs", "backend": "gymnasium", "rate": 2_000.0},
            {"part": "envs", "backend": "c", "rate": 50_000.0},
            {"part": "grounding", "backend": "c", "members": 1, "rate": 13_520.0},
            # Five at once make 16,900 steps a second: 5 * 2,048 steps take 0.606 s, one's 2,048 took 0.1515 s.
            {"part": "grounding", "backend": "c", "members": 5, "rate": 16_900.0},
            {"part": "sac", "members": 1, "rate": 300.0},
            {"part": "sac", "members": 5, "rate": 500.0},
        ]
    )
    assert [row.get("ratio") for row in rows] == [1.0, 25.0, 20.0, 25.0, None, None]
    assert [row.get("cost") for row in rows] == [None, None, None, 4.0, None, 3.0]


def test_an_environment_is_measured() -> None:
    row = simulation.measure_env("c", 2, seconds=0.01)
    assert row["rate"] > 0
    assert (row["backend"], row["copies"]) == ("c", 2)


def test_the_plan_covers_what_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    args = Args(part=("envs", "sac"), backend=("c",), copies=(8, 16), members=(1, 2))
    assert [(part, label) for part, label, _ in benchmark.plan(args)] == [
        ("envs", "gymnasium, 1 copy"),
        ("envs", "c, 8 copies"),
        ("envs", "c, 16 copies"),
        ("sac", "1 at once"),
        ("sac", "2 at once"),
    ]


def test_the_gpu_check_measures_both_engines_that_run_there(monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = re.findall(
        r"experiments\.benchmark (--part .*) \$\(ARGS\)", (ROOT / "Makefile").read_text("utf-8")
    )
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    planned = [(part, label) for part, label, _ in benchmark.plan(tyro.cli(Args, args=line.split()))]
    assert ("envs", "warp, 16384 copies") in planned and ("envs", "mjx, 1024 copies") in planned
    assert ("grounding", "warp, 5 at once") in planned and planned[-1] == ("sac", "25 at once")


def test_grounding_has_the_papers_batch() -> None:
    for _, _, call in benchmark.plan(Args(part=("grounding",), backend=("c",))):
        assert call.args[2].batch_size == 2_048  # type: ignore[attr-defined]


def test_the_record_is_written_as_json_and_markdown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured = {"members": 1, "batch": 256, "rate": 1_234.5, "calls": 3, "first_call_seconds": 0.1}
    monkeypatch.setattr(benchmark.sac, "measure_sac", lambda *_: measured)
    monkeypatch.setattr("sys.argv", ["benchmark", "--part", "sac", "--members", "1", "--out", str(tmp_path)])
    assert benchmark.main() == 0
    assert '"rate": 1234.5' in (tmp_path / "benchmark.json").read_text()
    assert "| 1 | 256 | 1,234 |  |" in (tmp_path / "benchmark.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "grond"], "--part grond is not known (allowed: envs, grounding, stages, sac)"),
        (["--backend", "cuda"], "--backend cuda is not known (allowed: c, mjx, warp)"),
        (["--copies", "0"], "--copies must be at least 1, got 0"),
        (["--members", "-1"], "--members must be at least 1, got -1"),
        (["--seconds", "0"], "--seconds must be positive, got 0.0"),
        (["--out", __file__], "is a file; give a folder"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    arguments: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    out = [] if "--out" in arguments else ["--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", ["benchmark", *arguments, *out])
    assert benchmark.main() == 2
    error = capsys.readouterr().err
    assert error.startswith("benchmark: ")
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="there is an accelerator")
def test_warp_without_an_nvidia_gpu_is_refused() -> None:
    with pytest.raises(ValueError, match="--backend warp needs an NVIDIA GPU"):
        benchmark.check(Args(backend=("warp",)))
