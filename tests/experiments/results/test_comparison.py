"""Methods against each other and against the paper, by hand."""

from pathlib import Path

import pytest

from experiments.results import comparison


def rows(**returns: list[float]) -> list[dict]:
    """Rows of methods, each at 500 samples but the bounds."""
    return [
        {"method": method, "samples": 0 if method in comparison.BOUNDS else 500, "return_stochastic": value}
        for method, values in returns.items()
        for value in values
    ]


def test_a_share_is_where_a_method_lies_between_the_bounds():
    (share,) = comparison.shares(rows(direct=[100.0, 300.0], SPG=[500.0, 700.0], target=[1200.0, 1000.0]))
    assert (share.method, share.samples) == ("SPG", 500)
    assert share.value == pytest.approx((600 - 200) / (1100 - 200))
    # Of two seeds a mean is one of the two, or that of both: the extremes are (500 - 300) / (1000 - 300) and
    # (700 - 100) / (1000 - 100), each drawn once in 64.
    low, high = share.interval
    assert low == pytest.approx(200 / 700, abs=0.05) and high == pytest.approx(600 / 900, abs=0.05)
    assert low < share.value < high
    assert share.told == f"0.44 ({low:.2f} to {high:.2f})"


def test_bounds_that_change_places_leave_no_interval():
    (share,) = comparison.shares(rows(direct=[0.0, 300.0], GAT=[150.0, 200.0], target=[100.0, 400.0]))
    assert share.value == pytest.approx(0.25) and share.interval is None


def test_seeds_that_agree_leave_no_doubt_and_one_seed_tells_none():
    (sure,) = comparison.shares(rows(direct=[0.0] * 3, GAT=[50.0] * 3, target=[100.0] * 3))
    assert sure.value == 0.5 and sure.interval == pytest.approx((0.5, 0.5))
    (alone,) = comparison.shares(rows(direct=[0.0], GAT=[50.0], target=[100.0]))
    assert alone.interval is None and alone.told == "0.50"


@pytest.mark.parametrize(
    "returns",
    [
        {"direct": [0.0], "GAT": [1.0]},
        {"GAT": [1.0], "target": [2.0]},
        {"direct": [5.0], "GAT": [1.0], "target": [5.0]},
    ],
    ids=["no target", "no direct", "nothing to gain"],
)
def test_without_bounds_there_is_no_share(returns, tmp_path: Path):
    assert comparison.shares(rows(**returns)) == []
    found = comparison.shares_by_task({"BrokenHopper": rows(**returns)})
    assert comparison.shares_table(found) == []
    assert not comparison.shares_figure(found, tmp_path / "shares.png")
    assert not (tmp_path / "shares.png").exists()


def test_what_was_not_run_is_shown_as_such(tmp_path: Path):
    one = rows(direct=[0.0, 0.0], SPG=[50.0, 50.0], target=[100.0, 100.0])
    two = rows(direct=[0.0, 0.0], GAT=[25.0, 25.0], target=[100.0, 100.0])
    found = comparison.shares_by_task({"BrokenHopper": one, "BrokenCheetah": two})
    text = comparison.shares_table(found)
    assert "| SPG | 500 | 0.50 (0.50 to 0.50) | - |" in text
    assert "| GAT | 500 | - | 0.25 (0.25 to 0.25) |" in text
    assert comparison.shares_figure(found, tmp_path / "shares.png")
    assert (tmp_path / "shares.png").read_bytes().startswith(b"\x89PNG")


def test_the_papers_tables_have_ours_beside():
    text = comparison.paper_tables({"BrokenHopper": rows(direct=[100.0, 300.0], SPG=[500.0, 701.0])})
    assert text[0] == "**BrokenHopper**, ours / the paper's: `direct` 200 / 164, `target` - / 862."
    assert "| 500 | 600 / 223 | - / 455 | - / 410 | - / 445 | - / 568 |" in text
    assert "| 10,000 | - / 341 | - / 417 | - / 670 | - / 479 | - / 578 |" in text
    assert text[-1] == "Not run: SkewedPendulum, BrokenCheetah, HeavyCheetah."
    assert comparison.paper_tables({"LateCheetah": []}) == []
