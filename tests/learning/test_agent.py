"""The agent's loop, in an environment whose every number is known beforehand."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs import State
from mpge_jax.learning import agent, sac
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import SACConfig
from tests import small


class Counting:
    """Observation `[steps so far, n]`, reward `steps so far + 1`; terminates after n = 3 or 5 steps, drawn at reset.

    With a `max_steps` of 4 the longer episodes are truncated. Beyond its end an episode is worth NaN.
    """

    name, observation_size, action_size = "Counting", 2, 1
    action_low, action_high = np.array([-2.0], np.float32), np.array([2.0], np.float32)

    def __init__(self, max_steps: int = 4):
        self.max_steps = max_steps

    def _state(self, steps, length, reward, terminated, truncated):
        obs = jnp.stack([steps, length])
        info = {
            "terminated": terminated,
            "truncated": truncated,
            "next_obs": obs,
            "steps": steps.astype(jnp.int32),
        }
        return State({}, obs, reward, jnp.maximum(terminated, truncated), {}, info)

    def reset(self, key):
        zero = jnp.zeros(())
        return self._state(zero, jnp.where(jax.random.bernoulli(key), 3.0, 5.0), zero, zero, zero)

    def step(self, state, action):
        steps, length = state.obs[0] + 1.0, state.obs[1]
        late = steps > jnp.minimum(length, float(self.max_steps))
        reward = jnp.where(late, jnp.nan, steps)
        terminated = (steps >= length).astype(jnp.float32)
        truncated = (steps >= self.max_steps).astype(jnp.float32)
        return self._state(steps, length, reward + 0.0 * action[0], terminated, truncated)


CONFIG = AgentConfig(
    sac=SACConfig(hidden=(8,), batch_size=8),
    num_envs=4,
    steps_per_iteration=10,
    updates_per_iteration=2,
    buffer_capacity=200,
    random_steps=21,
)


@pytest.fixture(scope="module")
def trained():
    """The state after `init` and two iterations, with a bonus of 100 n."""
    bonus = lambda obs: 100.0 * obs[1]  # noqa: E731
    first = jax.jit(lambda key: agent.init(key, Counting(), CONFIG, bonus=bonus))(jax.random.key(0))
    step = jax.jit(lambda state: agent.iterate(state, Counting(), CONFIG, bonus))
    state, metrics = step(first)
    second, later = step(state)
    return first, second, [metrics, later]


def columns(buffer):
    rows = np.asarray(buffer.rows)[: int(buffer.size)]
    obs, action, reward, following, terminated = np.split(rows, [2, 3, 4, 6], axis=1)
    return obs, action[:, 0], reward[:, 0], following, terminated[:, 0]


def test_random_steps_fill_whole_rounds_of_all_environments(trained):
    first, second, _ = trained
    assert int(first.buffer.size) == 24
    assert int(second.buffer.size) == 24 + 2 * 40
    action = columns(first.buffer)[1]
    assert np.abs(action).max() <= 2.0 and len(np.unique(action)) == 24
    # Over the whole box, not over +-1.
    assert np.abs(action).max() > 1.2


def test_a_policy_acts_in_the_whole_box_wherever_its_middle_is():
    env = Counting()
    env.action_low, env.action_high = np.array([-3.0], np.float32), np.array([-1.0], np.float32)
    actor = agent.init(jax.random.key(0), env, CONFIG).learner.actor
    action = sac.act(actor, jnp.zeros((2000, 2)), jax.random.key(1))
    assert -3.0 <= action.min() < -2.9 and -1.1 < action.max() <= -1.0
    # the mode of a fresh policy is near the middle
    np.testing.assert_allclose(sac.act(actor, jnp.zeros(2)), -2.0, atol=0.1)


def test_the_buffer_holds_true_next_observations_and_terminations(trained):
    obs, _, reward, following, terminated = columns(trained[1].buffer)
    np.testing.assert_array_equal(following[:, 0], obs[:, 0] + 1)
    np.testing.assert_array_equal(following[:, 1], obs[:, 1])
    np.testing.assert_array_equal(reward, following[:, 0] + 100 * obs[:, 1])
    # Episodes of 3 terminate; those of 5 are cut at 4, which is not a termination.
    np.testing.assert_array_equal(terminated, following[:, 0] >= following[:, 1])
    cut = (following[:, 0] == 4) & (obs[:, 1] == 5)
    assert cut.sum() > 3 and not terminated[cut].any()
    # After an end the same environment begins anew. Rows lie in order of time, 4 environments a step.
    ended = (terminated > 0) | cut
    np.testing.assert_array_equal(obs[4:, 0], np.where(ended[:-4], 0, following[:-4, 0]))


def test_returns_are_of_whole_episodes_without_the_bonus(trained):
    _, second, metrics = trained
    *_, following, terminated = columns(second.buffer)
    for env in range(4):
        reached = following[env::4]
        ends = np.flatnonzero((terminated[env::4] > 0) | (reached[:, 0] == 4))
        last = reached[ends[-1], 0]
        # 1 + 2 + 3 or 1 + 2 + 3 + 4.
        assert float(second.last_return[env]) == last * (last + 1) / 2
        now = len(reached) - 1 - ends[-1]
        assert float(second.episode_return[env]) == now * (now + 1) / 2
    assert float(metrics[1]["return"]) == np.mean(second.last_return)


def test_learning_has_begun_and_is_decided_by_the_key(trained):
    first, second, metrics = trained
    assert int(first.learner.step) == 0 and int(second.learner.step) == 4
    assert all(np.isfinite(x) for x in jax.tree.leaves(metrics))
    again = jax.jit(lambda key: agent.init(key, Counting(), CONFIG, bonus=lambda obs: 100.0 * obs[1]))
    jax.tree.map(np.testing.assert_array_equal, again(jax.random.key(0)).buffer, first.buffer)


def test_alternating_is_one_short_iteration_after_the_other(trained):
    first, _, _ = trained
    both = dataclasses.replace(CONFIG, alternations=2)
    half = dataclasses.replace(CONFIG, steps_per_iteration=5, updates_per_iteration=1)
    found, metrics = jax.jit(lambda state: agent.iterate(state, Counting(), both))(first)
    step = jax.jit(lambda state: agent.iterate(state, Counting(), half))
    middle, one = step(first)
    expected, other = step(middle)
    compare = partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6)
    jax.tree.map(compare, found.learner, expected.learner)
    np.testing.assert_array_equal(found.buffer.size, 24 + 40)
    compare(found.buffer.rows, expected.buffer.rows)
    compare(metrics["critic_loss"], (one["critic_loss"] + other["critic_loss"]) / 2)


def test_a_given_learner_is_gone_on_from():
    learner = small.policy_set().learner(0, small.SAC)
    config = dataclasses.replace(CONFIG, sac=small.SAC)
    state = jax.eval_shape(
        lambda key: agent.init(key, small.env("InvertedPendulum"), config, learner), jax.random.key(0)
    )
    assert jax.tree.structure(state.learner) == jax.tree.structure(learner)


def test_no_return_before_the_first_episode_ends():
    config = dataclasses.replace(CONFIG, random_steps=4, steps_per_iteration=1, updates_per_iteration=1)

    @jax.jit
    def run(key):
        return agent.iterate(agent.init(key, Counting(), config), Counting(), config)[1]["return"]

    assert np.isnan(run(jax.random.key(0)))


@pytest.mark.parametrize("stochastic", [False, True])
def test_evaluate_is_a_plain_loop_over_episodes(stochastic):
    env = small.env("InvertedPendulum")
    actor = jax.tree.map(lambda x: x[1], small.policy_set().actor)
    key = jax.random.key(4)
    found = jax.jit(lambda k: agent.evaluate(k, env, actor, 3, stochastic))(key)
    key_reset, key_act = jax.random.split(key)
    act = jax.jit(lambda obs, k: sac.act(actor, obs, k if stochastic else None))
    step, reset = jax.jit(env.step), jax.jit(env.reset)
    states = [reset(k) for k in jax.random.split(key_reset, 3)]
    total, over = np.zeros(3), np.zeros(3, bool)
    for key_now in jax.random.split(key_act, env.max_steps):
        actions = act(jnp.stack([state.obs for state in states]), key_now)
        for i in np.flatnonzero(~over):
            states[i] = step(states[i], actions[i])
            total[i] += float(states[i].reward)
            over[i] = bool(states[i].done)
        if over.all():
            break
    assert over.all() and total.max() < 100
    np.testing.assert_array_equal(found, total)


def test_evaluate_counts_nothing_beyond_the_end_of_an_episode():
    actor = agent.sac.init(jax.random.key(0), 2, 1, jnp.array([2.0]), CONFIG.sac).actor
    returns = jax.jit(lambda key: agent.evaluate(key, Counting(max_steps=10), actor, 20))(jax.random.key(0))
    # 1 + 2 + 3, or up to 5; one more step would add NaN.
    assert set(np.asarray(returns)) == {6.0, 15.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
        ({"random_steps": 0}, "random_steps must be at least 1"),
        ({"alternations": 0}, "alternations must be at least 1"),
        ({"alternations": 3}, "steps_per_iteration of 10 cannot be divided into 3 alternations"),
        ({"buffer_capacity": 39}, "buffer_capacity of 39 does not hold the 40 transitions"),
        # 41 random steps are taken as 11 rounds of 4.
        (
            {"buffer_capacity": 43, "random_steps": 41},
            "buffer_capacity of 43 does not hold the 44 transitions",
        ),
    ],
)
def test_a_configuration_out_of_range_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(CONFIG, **change)
