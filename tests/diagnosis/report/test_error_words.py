"""How errors change, in words."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mpge_jax.diagnosis.report.error_words import (
    _usual_window,
    beside_noise,
    moves,
    times,
    untold,
    worse_without,
)


def test_errors_beside_noise_in_words():
    assert times(12.0, 1.0) == "12 times" and times(1.0, 1e-9) == "more than 1000 times"
    assert times(1.0, 12.0) == "12 times"
    assert beside_noise(2.0, 1.0, "rad") == "noise and timestep alone give 1 rad"
    assert beside_noise(2.0, 1.0, "N m", moves=False) == "noise alone gives 1 N m"
    assert "no more than measurement noise" in beside_noise(1.0, 1.0, "rad")
    assert beside_noise(1.0, 3.0, "rad").endswith("its estimate is too high: it would give 3 rad")


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (12.0, 1.0, "falls from 12 to 1 rad, 12 times smaller"),
        (0.884, 1.0, "rises from 0.884 to 1 rad, 1.13 times larger"),
        (1.0, 1.0001, "stays at 1 rad"),
        (0.0734, 0.0733, "hardly falls from 0.0734 to 0.0733 rad"),
    ],
)
def test_an_error_falls_only_where_it_is_smaller(before, after, said):
    assert moves(before, after, "rad") == said


def test_the_worth_of_an_effect_is_the_error_without_it():
    assert worse_without(0.75) == "2 times" and worse_without(1.0) == "more than 1000 times"
    assert worse_without(-0.1) == "smaller" and worse_without(0.001) == "hardly larger"


@pytest.mark.parametrize(
    ("after", "said"),
    [
        pytest.param(
            [0.02, 0.02, 2.0],
            "; few windows hold most of it: that of the usual one falls from 0.2 to 0.02 rad, 10 times smaller",
            id="something else acts in one",
        ),
        pytest.param([0.02, 0.02, 0.2], "", id="all alike"),
        pytest.param([0.2, 0.2, 0.4], "", id="one is better"),
    ],
)
def test_the_usual_window_is_told_where_few_hide_it(after, said):
    errors = [
        SimpleNamespace(window=x, rms=float(np.sqrt((x**2).mean())))
        for x in (np.array([0.2, 0.2, 2.0]), np.array(after))
    ]
    held = SimpleNamespace(before=errors[0], after=errors[1], floors=np.full(3, 0.01))
    assert _usual_window(held, "rad") == said


@pytest.mark.parametrize(
    ("after", "said"),
    [
        pytest.param([0.01, 0.02, 0.02], "", id="noise"),
        pytest.param(
            [0.01, 0.01, 0.1],
            "In a few windows of the test recordings the error is still 5.83 times",
            id="one",
        ),
        pytest.param([0.03, 0.03, 0.03], "In the test recordings the error is still 3 times", id="all"),
    ],
)
def test_errors_far_beyond_noise_that_nothing_accounts_for_are_told(after, said):
    window = np.array(after)
    errors = SimpleNamespace(window=window, rms=float(np.sqrt((window**2).mean())))
    held = SimpleNamespace(after=errors, floors=np.full(3, 0.01), floor=0.01)
    d = SimpleNamespace(held=held, ctx=SimpleNamespace(contacts=False))
    assert untold(d).startswith(said) and bool(untold(d)) == bool(said)
    # of impacts a warning tells
    assert untold(SimpleNamespace(held=held, ctx=SimpleNamespace(contacts=True))) == ""
