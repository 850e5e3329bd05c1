"""Which function is chosen, from data that it was not fitted to."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.residual.regression import (
    Blocks,
    Choice,
    Rows,
    best_function,
    fewest,
    in_the_race,
    roughness,
    smoothed,
    solved,
    told,
)

ANGLE, SPEED = Axis("q", -1.0, 1.0), Axis("v", -3.0, 3.0)
FUNCTIONS = [Residual(axes, 3.0) for axes in ((ANGLE,), (SPEED,), (ANGLE, SPEED))]
FOLD = np.arange(40) % 5


def candidates(law, noise: float = 0.01, weight: float = 1.0):
    """40 blocks of 20 rows; what is missing is the negative of what the function must be."""
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-1, 1, (40, 20)), rng.uniform(-3, 3, (40, 20))
    left = -law(q, v) + noise * rng.standard_normal(q.shape)
    known = {"q": q, "v": v}
    return [
        (e, 0, Blocks.of(np.array(e.basis(np, [known[a.input] for a in e.axes])), left, np.full(40, weight)))
        for e in FUNCTIONS
    ]


@pytest.mark.parametrize(
    ("law", "inputs"),
    [
        (lambda q, v: 0.3 * np.sin(3 * q), "q"),
        (lambda q, v: -0.1 * v * np.abs(v), "v"),
        (lambda q, v: 0.2 * v * np.cos(2 * q), "qv"),
    ],
)
def test_the_inputs_are_those_of_the_law(law, inputs):
    found = best_function(told(candidates(law), FOLD))
    assert "".join(a.input for a in found.effect.axes) == inputs
    q, v = np.meshgrid(np.linspace(-0.9, 0.9, 7), np.linspace(-2.7, 2.7, 7))
    values = [{"q": q, "v": v}[i] for i in inputs]
    np.testing.assert_allclose(found.effect.value(np, found.values, values), law(q, v), atol=0.03)


def test_noise_is_no_function():
    assert best_function(told(candidates(lambda q, v: 0.0 * q, noise=0.1), FOLD)) is None
    assert told(candidates(lambda q, v: 0.3 * q), np.zeros(len(FOLD))) == []


def test_what_explains_half_as_much_is_in_the_race():
    """Of q^2 + v its two inputs explain parts, and both together all."""
    these = candidates(lambda q, v: 0.3 * q**2 + 0.08 * v)
    tried = told(these, FOLD)
    gains = {these[t.number][0].axes: t.gain for t in tried}
    most = max(gains.values())
    running = [these[k][0].axes for k in in_the_race(tried)]
    assert running == [axes for axes, gain in gains.items() if gain > 0.5 * most]
    assert {len(axes) for axes in running} == {1, 2} and len(running) < len(tried)


def test_the_penalty_pulls_towards_nothing_and_towards_smoothness():
    effect, _, b = candidates(lambda q, v: 0.3 * np.sin(3 * q))[0]
    rough, strengths = roughness(effect), np.array([1e-9, 1e3])
    free, stiff = solved(*b.summed(), rough, strengths)
    assert stiff @ rough @ stiff < 0.1 * free @ rough @ free
    # the same problem told as one of changes of some values has the same solution and leaves the same
    values = np.linspace(-1.0, 2.0, free.size)
    (left,) = b.left(values[None])
    same = Blocks(b.gram, b.push + b.gram @ values, left / b.weight, b.weight).told_at(values)
    np.testing.assert_allclose(solved(*same.summed(), rough, strengths)[0], free, atol=1e-6)
    np.testing.assert_allclose(same.left(stiff[None]), b.left(stiff[None]), rtol=1e-9)


def test_blocks_hold_the_squares_of_what_is_left():
    rng = np.random.default_rng(1)
    columns, left, x = (
        rng.standard_normal((3, 4, 5)),
        rng.standard_normal((4, 5)),
        rng.standard_normal((2, 3)),
    )
    b = Blocks.of(columns, left, np.array([1.0, 2.0, 1.0, 1.0]))
    want = ((left + np.einsum("pbm,sp->sbm", columns, x)) ** 2).sum(2) * b.weight
    np.testing.assert_allclose(b.left(x), want)


def test_more_values_are_taken_where_they_leave_less_beyond_doubt():
    rng = np.random.default_rng(2)
    known = rng.uniform(1.0, 2.0, 40)

    def told(count: int, left: np.ndarray) -> Choice:
        return Choice(FUNCTIONS[0].told_by((count,)), 0, np.zeros(count), left, 1.0)

    few, as_good = told(9, known), told(18, known + 1e-3 * rng.standard_normal(40) - 1e-5)
    # nearly all is explained by either, and yet half of what is left by the one is not by the other
    better = told(36, 0.5 * known)
    assert fewest([few, as_good]) is few
    assert fewest([few, as_good, better]) is better


def test_rows_are_blocks_of_one_number():
    rng = np.random.default_rng(3)
    q, weight = rng.uniform(-1.0, 1.0, 40), rng.uniform(0.5, 1.0, 40)
    columns, left = np.array(FUNCTIONS[0].basis(np, [q])), np.sin(3.0 * q) + 0.1 * rng.standard_normal(40)
    blocks, rows = Blocks.of(columns[..., None], left[:, None], weight), Rows(columns, left, weight)
    np.testing.assert_allclose(rows.whole, blocks.whole)
    want, got = (smoothed(FUNCTIONS[0], 0, b, FOLD) for b in (blocks, rows))
    assert got.strength == want.strength
    np.testing.assert_allclose(got.values, want.values)
    np.testing.assert_allclose(got.left, want.left, atol=1e-12)
