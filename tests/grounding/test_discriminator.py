"""The discriminator: loss, penalty, entropy and reward by hand, both label conventions, health figures."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding import discriminator
from mpge_jax.grounding.discriminator import DiscriminatorConfig, Transitions
from mpge_jax.learning import normalise

OBS, ACT, ROWS = 2, 1, 64
SMALL = DiscriminatorConfig(hidden=(16, 16), learning_rate=3e-3)
update = jax.jit(discriminator.update, static_argnames="config")


def transitions(seed, step):
    """Rows that a target with a longer `step` tells apart: s' = s + step * a in the first feature."""
    obs_key, action_key = jax.random.split(jax.random.key(seed))
    observation = jax.random.normal(obs_key, (ROWS, OBS))
    action = jax.random.uniform(action_key, (ROWS, ACT), minval=-1.0)
    return Transitions(observation, action, observation.at[:, :1].add(step * action))


def linear(weights, bias):
    kernel = jnp.array(weights)[:, None]
    return {"params": {"Dense_0": {"kernel": kernel, "bias": jnp.array([bias])}}}


def sigmoid(x):
    return 1 / (1 + np.exp(-np.asarray(x, np.float64)))


def trained(config, updates=300):
    state = discriminator.init(jax.random.key(0), OBS, ACT, config)

    def step(state, key):
        return discriminator.update(state, transitions(1, 0.5), transitions(2, 2.0), key, config)

    return jax.jit(lambda s: jax.lax.scan(step, s, jax.random.split(jax.random.key(3), updates)))(state)


def test_loss_of_a_linear_discriminator_by_hand():
    config = DiscriminatorConfig(
        hidden=(), entropy_coefficient=0.5, penalty_coefficient=10.0, penalty_target=2.0
    )
    params = linear([3.0, 4.0], -1.0)
    grounded, target = jnp.array([[1.0, 0.0], [0.0, 0.25]]), jnp.array([[0.0, -0.5], [1.0, 0.5]])
    # Logits 3 - 1 = 2 and 1 - 1 = 0 grounded, -2 - 1 = -3 and 3 + 2 - 1 = 4 target.
    p = sigmoid([2.0, 0.0, -3.0, 4.0])
    cross_entropy = -np.log(p[:2]).mean() - np.log(1 - p[2:]).mean()
    entropy = (-p * np.log(p) - (1 - p) * np.log(1 - p)).mean()
    # |(3, 4)| = 5 everywhere, so the penalty is (5 - 2)^2 = 9.
    total, metrics = discriminator.loss(params, grounded, target, jnp.full((2, 1), 0.5), config)
    assert float(total) == pytest.approx(cross_entropy - 0.5 * entropy + 90.0, rel=1e-6)
    assert float(metrics["loss"]) == float(total)
    assert float(metrics["gradient_penalty"]) == pytest.approx(9.0, rel=1e-5)
    assert float(metrics["entropy"]) == pytest.approx(entropy, rel=1e-5)
    assert float(metrics["accuracy_grounded"]) == 0.5  # logit 0 is no verdict
    assert float(metrics["accuracy_target"]) == 0.5
    assert float(metrics["logit_gap"]) == pytest.approx(1.0 - 0.5)


def test_penalty_of_a_tanh_unit_by_hand():
    # logit = 2 tanh(3 x): slope 6 (1 - tanh(3 x)^2), at x = 0: 6, at x = 1/2: 6 (1 - tanh(1.5)^2)
    params = {
        "params": {
            "Dense_0": {"kernel": jnp.array([[3.0]]), "bias": jnp.zeros(1)},
            "Dense_1": {"kernel": jnp.array([[2.0]]), "bias": jnp.zeros(1)},
        }
    }
    config = DiscriminatorConfig(hidden=(1,))
    slopes = np.array([6.0, 6.0 * (1 - np.tanh(1.5) ** 2)])
    penalty = discriminator.gradient_penalty(params, jnp.array([[0.0], [0.5]]), config)
    assert float(penalty) == pytest.approx(((slopes - 1.0) ** 2).mean(), rel=1e-5)
    # For the outer weight v: slope = 3 v (1 - t^2), so d/dv (slope - 1)^2 = 2 (slope - 1) slope / v.
    gradient = jax.grad(discriminator.gradient_penalty)(params, jnp.array([[0.0], [0.5]]), config)
    expected = (2 * (slopes - 1) * slopes / 2.0).mean()
    assert float(gradient["params"]["Dense_1"]["kernel"][0, 0]) == pytest.approx(expected, rel=1e-4)


def test_penalty_survives_a_flat_discriminator():
    gradient = jax.grad(discriminator.gradient_penalty)(
        linear([0.0, 0.0], 0.0), jnp.ones((3, 2)), DiscriminatorConfig(hidden=())
    )
    assert all(bool(jnp.all(jnp.isfinite(x))) for x in jax.tree.leaves(gradient))


@pytest.mark.parametrize("config", [SMALL, dataclasses.replace(SMALL, interpolation="constant")])
def test_interpolation(config):
    state = discriminator.init(jax.random.key(0), OBS, ACT, config)
    grounded, target = transitions(1, 0.5), transitions(2, 2.0)
    penalties = [
        float(update(state, grounded, target, jax.random.key(k), config)[1]["gradient_penalty"])
        for k in range(2)
    ]
    assert (penalties[0] == penalties[1]) == (config.interpolation == "constant")
    if config.interpolation == "constant":
        both = jax.tree.map(lambda g, t: jnp.concatenate([g, t]), grounded, target)
        pair = jnp.concatenate([both.observation, both.action], axis=-1)
        stats = normalise.update(normalise.init(OBS + ACT), pair)
        inputs = discriminator.network_inputs(stats, both, config)
        weight = state.interpolation[None]
        between = weight * inputs[:ROWS] + (1.0 - weight) * inputs[ROWS:]
        expected = discriminator.gradient_penalty(state.params, between, config)
        assert penalties[0] == pytest.approx(float(expected), rel=1e-5)


def test_constant_weights_stay_for_the_whole_run():
    config = dataclasses.replace(SMALL, interpolation="constant")
    state = discriminator.init(jax.random.key(0), OBS, ACT, config)
    after, _ = update(state, transitions(1, 0.5), transitions(2, 2.0), jax.random.key(1), config)
    np.testing.assert_array_equal(after.interpolation, state.interpolation)
    assert float(state.interpolation.min()) >= 0.0 and float(state.interpolation.max()) <= 1.0


def test_inputs_by_hand():
    # s' is scaled by the statistics of s; the action has its own.
    stats = normalise.RunningStats(
        count=jnp.array(9.0), mean=jnp.array([1.0, 10.0, -1.0]), variance=jnp.array([4.0, 0.0, 0.25])
    )
    rows = Transitions(jnp.array([[3.0, 10.5]]), jnp.array([[0.0]]), jnp.array([[5.0, 9.0]]))
    # (3-1)/2, (10.5-10)/0.1 with the floor, (0+1)/0.5, (5-1)/2, (9-10)/0.1
    np.testing.assert_allclose(
        discriminator.network_inputs(stats, rows, SMALL), [[1.0, 5.0, 2.0, 2.0, -10.0]], rtol=1e-5
    )


def test_inputs_with_a_residual_by_hand():
    config = dataclasses.replace(SMALL, next_as="residual")
    stats = normalise.RunningStats(
        count=jnp.array(9.0),
        mean=jnp.array([1.0, 10.0, -1.0, 0.5, 0.0]),
        variance=jnp.array([4.0, 0.0, 0.25, 1.0, 0.0]),
    )
    rows = Transitions(
        observation=jnp.array([[3.0, 10.5]]),
        action=jnp.array([[0.0]]),
        next_observation=jnp.array([[5.0, 9.0]]),
        expected=jnp.array([[3.5, 9.25]]),
    )
    # The residuals are 5 - 3.5 = 1.5 and 9 - 9.25 = -0.25: (1.5-0.5)/1 and (-0.25-0)/0.1 with the floor.
    np.testing.assert_allclose(
        discriminator.network_inputs(stats, rows, config), [[1.0, 5.0, 2.0, 1.0, -2.5]], rtol=1e-5
    )
    with pytest.raises(ValueError, match="needs rows with `expected`"):
        discriminator.network_inputs(stats, rows.replace(expected=None), config)


def test_a_residual_is_all_that_tells_one_step_from_another():
    config = dataclasses.replace(SMALL, next_as="residual")
    state = discriminator.init(jax.random.key(0), OBS, ACT, config)

    def rows(seed, step):
        made = transitions(seed, step)
        return made.replace(expected=transitions(seed, 1.0).next_observation)

    def learn(state, key):
        return discriminator.update(state, rows(1, 1.0), rows(2, 1.5), key, config)

    state, _ = jax.jit(lambda s: jax.lax.scan(learn, s, jax.random.split(jax.random.key(3), 300)))(state)
    fresh = jnp.concatenate(
        [
            discriminator.logits_grounded_is_high(state, rows(seed, step), config)
            for seed, step in ((7, 1.0), (8, 1.5))
        ]
    )
    right = np.asarray(fresh > 0) == (np.arange(2 * ROWS) < ROWS)
    assert right.mean() > 0.8


def test_statistics_take_in_both_sides():
    state = discriminator.init(jax.random.key(0), OBS, ACT, SMALL)
    grounded, target = transitions(1, 0.5), transitions(2, 2.0)
    for _ in range(2):
        state, _ = update(state, grounded, target, jax.random.key(1), SMALL)
    rows = np.concatenate([np.hstack([x.observation, x.action]) for x in (grounded, target)])
    assert float(state.stats.count) == 4 * ROWS
    np.testing.assert_allclose(state.stats.mean, rows.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(state.stats.variance, rows.var(axis=0), rtol=1e-5)


def test_reward_by_hand():
    # -log P(grounded): a coin toss earns log 2, surely the target's a lot, surely grounded nothing.
    logits = jnp.array([0.0, -3.0, 3.0, -40.0, 40.0, -jnp.inf, jnp.inf])
    expected = [np.log(2.0), -np.log(sigmoid(-3.0)), -np.log(sigmoid(3.0)), 18.420681, 1e-8, 18.420681, 1e-8]
    np.testing.assert_allclose(discriminator.reward_from_logits(logits), expected, rtol=1e-5)


def test_reward_is_the_clipped_form_of_the_release():
    # There the logit is high for the target and the reward is -log clip(1 - sigmoid, 1e-8, 1 - 1e-8).
    target_is_high = np.linspace(-30.0, 30.0, 121)
    expected = -np.log(np.clip(1.0 - sigmoid(target_is_high), 1e-8, 1.0 - 1e-8))
    result = discriminator.reward_from_logits(jnp.asarray(-target_is_high, jnp.float32))
    np.testing.assert_allclose(result, expected, rtol=1e-4)
    assert np.all(np.diff(result) >= 0)


@pytest.mark.parametrize("labels", ["paper", "release"])
def test_target_like_rows_earn_more(labels):
    config = dataclasses.replace(SMALL, labels=labels)
    state, metrics = trained(config)
    reward = jax.jit(discriminator.reward, static_argnames="config")
    like_target, like_source = (reward(state, transitions(7, step), config) for step in (2.0, 0.5))
    assert float(like_target.mean()) > np.log(2.0) > float(like_source.mean())
    assert float(jnp.mean(like_target > like_source)) > 0.9
    logits = discriminator.logits_grounded_is_high(state, transitions(7, 2.0), config)
    assert float(logits.mean()) < 0
    for side in ("accuracy_grounded", "accuracy_target"):
        assert float(metrics[side][-1]) > 0.75
    assert float(metrics["logit_gap"][-1]) > 0.5 > float(metrics["logit_gap"][0])
    assert float(metrics["loss"][-1]) < float(metrics["loss"][0])


def test_presets_differ_by_the_sign_of_the_output_alone():
    release_config = dataclasses.replace(SMALL, labels="release")
    paper = discriminator.init(jax.random.key(0), OBS, ACT, SMALL)
    layers = paper.params["params"] | {
        "Dense_2": jax.tree.map(lambda x: -x, paper.params["params"]["Dense_2"])
    }
    release = paper.replace(params={"params": layers})
    for i in range(5):
        rows = transitions(10 + i, 0.5), transitions(20 + i, 2.0), jax.random.key(i)
        paper, paper_metrics = update(paper, *rows, SMALL)
        release, release_metrics = update(release, *rows, release_config)
    for name, value in paper_metrics.items():
        assert float(release_metrics[name]) == pytest.approx(float(value), rel=1e-4, abs=1e-6), name
    np.testing.assert_allclose(
        release.params["params"]["Dense_2"]["kernel"], -paper.params["params"]["Dense_2"]["kernel"], atol=1e-5
    )
    rows = transitions(5, 1.0)
    np.testing.assert_allclose(
        discriminator.reward(release, rows, release_config),
        discriminator.reward(paper, rows, SMALL),
        rtol=1e-3,
    )
    raw = discriminator.logits_grounded_is_high(paper, rows, SMALL)
    np.testing.assert_allclose(
        discriminator.logits_grounded_is_high(paper, rows, release_config), -raw, rtol=1e-6
    )


def test_penalty_holds_the_slope():
    free, _ = trained(dataclasses.replace(SMALL, penalty_coefficient=0.0))
    held, metrics = trained(SMALL)
    rows = transitions(7, 2.0)
    spread = [float(discriminator.logits_grounded_is_high(s, rows, SMALL).std()) for s in (free, held)]
    assert spread[0] > 2 * spread[1]
    assert float(metrics["gradient_penalty"][-1]) < 0.25


def test_vmap_equals_separate_runs():
    members = [
        (
            discriminator.init(jax.random.key(i), OBS, ACT, SMALL),
            transitions(1, 0.5),
            transitions(2, 1.0 + i),
            jax.random.key(i),
        )
        for i in range(2)
    ]
    run = partial(discriminator.update, config=SMALL)
    together = jax.jit(jax.vmap(run))(*jax.tree.map(lambda *x: jnp.stack(x), *members))
    alone = [jax.jit(run)(*member) for member in members]
    compare = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    jax.tree.map(compare, together, jax.tree.map(lambda *x: np.stack(x), *alone))


def test_unequal_sides_are_refused():
    state = discriminator.init(jax.random.key(0), OBS, ACT, SMALL)
    short = jax.tree.map(lambda x: x[:8], transitions(1, 0.5))
    with pytest.raises(ValueError, match=r"need one shape, got \(8, 2\) and \(64, 2\)"):
        discriminator.update(state, short, transitions(2, 2.0), jax.random.key(0), SMALL)


def test_another_tasks_rows_are_refused():
    state = discriminator.init(jax.random.key(0), OBS + 1, ACT, SMALL)
    with pytest.raises(ValueError, match=r"statistics of 4 numbers, got 3 .* logged in another task"):
        discriminator.reward(state, transitions(1, 0.5), SMALL)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("learning_rate", 0.0),
        ("std_floor", 0.0),
        ("penalty_coefficient", -1.0),
        ("labels", "papre"),
        ("interpolation", "per-sample"),
    ],
)
def test_configuration_is_checked(name, value):
    with pytest.raises(ValueError, match=f"DiscriminatorConfig: {name} must"):
        dataclasses.replace(SMALL, **{name: value})
