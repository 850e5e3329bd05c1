"""One update of grounding, piece by piece: what is judged, rewarded, compared and learned from.

On the point probe, whose every step is a line of algebra, for each way of estimating advantages and each learner.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding import adversarial, collect, discriminator, transform_error
from mpge_jax.grounding.discriminator import Transitions
from mpge_jax.learning import ppo, trpo, value
from mpge_jax.learning.ppo import PPOConfig
from tests import points

LEARNERS = {"trpo": trpo, "ppo": ppo}
PPO = PPOConfig(epochs=1, minibatch_size=8)
RESIDUAL = dataclasses.replace(points.CONFIG.discriminator, next_as="residual")
CASES = {
    # The paper: one draw at a state, values, D on s'; Algorithm 1's order, then the release's, here with PPO.
    "paper": points.CONFIG,
    "release ppo": dataclasses.replace(
        points.CONFIG, policy=PPO, discriminator_first=False, value_heads="one_hot"
    ),
    # Ours: three draws at a state, D on what is left of s', averaged iterates.
    "vine": dataclasses.replace(points.CONFIG, branches=3, discriminator=RESIDUAL, averaging=0.9),
    "vine ppo": dataclasses.replace(points.CONFIG, branches=3, discriminator=RESIDUAL, policy=PPO),
}


@pytest.fixture(scope="module", params=["paper", "release ppo", "vine"])
def one(request):
    """An update taken apart: state, next state, rows, what the learner was handed, rewards before and after D's."""
    config = CASES[request.param]
    learner = LEARNERS["ppo" if isinstance(config.policy, PPOConfig) else "trpo"]
    policies, log = points.policies(), points.log()
    patch = pytest.MonkeyPatch()
    learner_update, value_update = learner.update, value.update

    def exposed(state, batch, *rest):
        state, metrics = learner_update(state, batch, *rest)
        return state, {**metrics, "batch": batch}

    def exposed_value(state, inputs, policy, returns, *rest):
        new, metrics = value_update(state, inputs, policy, returns, *rest)
        return new, {**metrics, "inputs": inputs, "policy": policy, "returns": returns}

    patch.setattr(learner, "update", exposed)
    patch.setattr(value, "update", exposed_value)

    @jax.jit
    def run(key):
        state = adversarial.init(key, points.SOURCE, policies, log, config)
        after, metrics = adversarial.update(state, points.SOURCE, policies, log, config)
        key_collect = jax.random.split(state.key, 5)[0]
        _, rows = collect.collect(
            key_collect,
            state.current,
            (state.env_state, state.rollout_policy),
            points.SOURCE,
            policies,
            log,
            config,
        )
        judged = Transitions(rows.observation, rows.action, rows.next_observation, rows.expected)
        rewards = {
            name: discriminator.reward(judge.discriminator, judged, config.discriminator)
            for name, judge in (("before", state), ("after", after))
        }
        return state, after, metrics, rows, rewards

    result = run(jax.random.key(0))
    patch.undo()
    return config, *result


def test_the_reward_is_of_the_discriminator_that_the_order_asks_for(one):
    config, _, _, metrics, _, rewards = one
    used, other = ("after", "before") if config.discriminator_first else ("before", "after")
    np.testing.assert_allclose(metrics["reward"], np.mean(rewards[used]), rtol=1e-5)
    assert abs(float(np.mean(rewards[used]) - np.mean(rewards[other]))) > 1e-4


def test_the_advantage_is_the_reward_less_its_baseline(one):
    config, state, _, metrics, rows, rewards = one
    reward = np.asarray(rewards["after" if config.discriminator_first else "before"])
    found = np.asarray(metrics["policy_batch"].advantages)
    if config.branches == 1:
        values = value.predict(state.value.params, metrics["inputs"], rows.rollout_policy, config.value(3))
        np.testing.assert_allclose(found, reward - np.asarray(values), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(metrics["returns"], reward, rtol=1e-5)
        return
    assert "returns" not in metrics
    draws = reward.reshape(config.steps_per_iteration, config.branches, config.num_envs)
    for j in range(3):
        others = draws[:, [i for i in range(3) if i != j]].mean(axis=1)
        mine = found.reshape(draws.shape)[:, j]
        np.testing.assert_allclose(mine, draws[:, j] - others, rtol=1e-3, atol=1e-5)
    # A draw that is judged better than its siblings has the higher advantage.
    best = draws.argmax(axis=1)
    np.testing.assert_array_equal(found.reshape(draws.shape).argmax(axis=1), best)


def test_the_values_learn_only_where_they_are_the_baseline(one):
    config, state, after, _, _, _ = one
    same = [
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(state.value), jax.tree.leaves(after.value), strict=True)
    ]
    assert all(same) if config.branches > 1 else not any(same[: len(same) // 3])


def test_what_was_collected_is_what_is_learned_from_row_by_row(one):
    _, _, _, metrics, rows, _ = one
    batch = metrics["policy_batch"]
    np.testing.assert_array_equal(batch.actions, rows.delta)
    # Two programs round the same sums apart.
    nearly = partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6)
    nearly(batch.log_probs, rows.log_prob)
    nearly(batch.inputs, np.concatenate([rows.observation, rows.action], axis=1))


def test_rows_are_the_sources_and_residuals_are_what_the_draw_did(one):
    config, _, _, _, rows, _ = one
    executed = np.clip(np.asarray(rows.action) + np.clip(np.asarray(rows.delta), -2, 2), -1, 1)
    np.testing.assert_allclose(
        rows.next_observation, 0.8 * np.asarray(rows.observation) + executed, atol=1e-6
    )
    if not config.needs_expected:
        assert rows.expected is None
        return
    asked = np.clip(np.asarray(rows.action), -1, 1)
    left = np.asarray(rows.next_observation) - np.asarray(rows.expected)
    np.testing.assert_allclose(left, executed - asked, atol=1e-6)


def test_the_result_is_the_last_iterate_or_their_average(one):
    config, state, after, _, _, _ = one
    moved = lambda a, p: config.averaging * np.asarray(a) + (1 - config.averaging) * np.asarray(p)  # noqa: E731
    jax.tree.map(
        partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6),
        after.result.params,
        jax.tree.map(moved, state.average, after.current.params),
    )
    if config.averaging == 0:
        jax.tree.map(np.testing.assert_array_equal, after.result.params, after.current.params)


@pytest.mark.parametrize("name", ["paper", "vine", "vine ppo"])
def test_grounding_finds_the_shift_of_the_point(name):
    """Doing nothing is 0.5 off; going the wrong way ends at 1 and more."""
    case = CASES[name]
    trust_region = dataclasses.replace(points.CONFIG.policy, max_kl=0.01)
    config = dataclasses.replace(
        case,
        num_envs=48 // case.branches,
        steps_per_iteration=8,
        averaging=0.8,
        policy=PPOConfig(1e-3, epochs=4, minibatch_size=96) if name == "vine ppo" else trust_region,
        discriminator=dataclasses.replace(case.discriminator, hidden=(32,), learning_rate=3e-3),
        discriminator_updates=8,
        discriminator_batch=64,
        value_minibatch=32,
    )
    policies, log = points.policies(), points.log(steps=300)

    @jax.jit
    def run(key):
        def step(state, _):
            return adversarial.update(state, points.SOURCE, policies, log, config)[0], None

        state = adversarial.init(key, points.SOURCE, policies, log, config)
        return jax.lax.scan(step, state, None, 120)[0].result

    rows = log.rows()
    given = jnp.asarray(rows["observation"]), jnp.asarray(rows["action"])
    error = float(transform_error.mean_error(run(jax.random.key(0)), points.SOURCE, points.truth, *given))
    print(name, error)
    assert error < 0.25
