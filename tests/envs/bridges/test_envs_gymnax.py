"""gymnax's interface on our environments, and a trainer written against it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, compiled


@pytest.fixture(scope="module")
def bridge():
    return envs.as_gymnax(compiled("InvertedPendulum").env)


def test_it_describes_itself(bridge):
    assert (bridge.name, bridge.num_actions) == ("InvertedPendulum", 1)
    assert bridge.default_params.max_steps_in_episode == 1000
    assert jax.tree.leaves(bridge.default_params.replace(max_steps_in_episode=7)) == [7]
    actions, observations = bridge.action_space(), bridge.observation_space(bridge.default_params)
    assert (actions.shape, observations.shape) == ((1,), (4,))
    np.testing.assert_array_equal([actions.low, actions.high], [[-3.0], [3.0]])
    samples = jax.vmap(actions.sample)(jax.random.split(jax.random.key(0), 200))
    assert samples.shape == (200, 1) and samples.dtype == jnp.float32
    assert -3 <= samples.min() < -2.8 and 2.8 < samples.max() <= 3
    assert actions.contains(jnp.array([3.0])) and not actions.contains(jnp.array([3.1]))
    assert observations.contains(jnp.full(4, 1e30))


def test_it_resets_where_an_episode_ends(bridge):
    """Fallen, out of time, both and neither, in one batch; the true next observation is in `info`."""
    _, state = jax.vmap(bridge.reset)(jax.random.split(jax.random.key(0), COPIES))
    angle, steps = jnp.array([0.5, 0.0, 0.5, 0.0]), jnp.array([3, 999, 999, 3], jnp.int32)
    data = state.data.replace(qpos=jnp.stack([jnp.zeros(4), angle], axis=1), qvel=jnp.zeros((4, 2)))
    state = state.replace(data=data, info={**state.info, "steps": steps})
    keys = jax.random.split(jax.random.key(1), COPIES)
    actions = jnp.zeros((COPIES, 1))
    obs, after, reward, done, info = jax.jit(jax.vmap(bridge.step))(keys, state, actions)
    plain = compiled("InvertedPendulum").step(state, actions)
    np.testing.assert_array_equal(info["terminated"], [True, False, True, False])
    np.testing.assert_array_equal(info["truncated"], [False, True, True, False])
    np.testing.assert_array_equal(info["discount"], [0.0, 1.0, 0.0, 1.0])
    np.testing.assert_array_equal(done, [True, True, True, False])
    assert done.dtype == bool
    np.testing.assert_array_equal(info["next_obs"], plain.obs)
    np.testing.assert_array_equal(reward, plain.reward)
    first = jax.vmap(bridge.reset)(keys)[0]
    np.testing.assert_allclose(obs, jnp.where(done[:, None], first, plain.obs), atol=1e-7)
    np.testing.assert_array_equal(after.obs, obs)
    np.testing.assert_array_equal(bridge.get_obs(after), obs)
    np.testing.assert_array_equal(after.info["steps"], [0, 0, 0, 4])
    np.testing.assert_array_equal(after.data.time[:3], np.zeros(3))


def test_the_params_cut_an_episode_short(bridge):
    params = bridge.default_params.replace(max_steps_in_episode=3)
    state = bridge.reset(jax.random.key(0), params)[1]

    def body(state, key):
        _, state, _, done, info = bridge.step(key, state, jnp.zeros(1), params)
        return state, (done, info["truncated"], info["terminated"])

    done, truncated, terminated = jax.lax.scan(body, state, jax.random.split(jax.random.key(1), 7))[1]
    np.testing.assert_array_equal(done, [False, False, True] * 2 + [False])
    np.testing.assert_array_equal(truncated, done)
    assert not terminated.any()


def test_one_action_may_be_a_scalar(bridge):
    obs, state = bridge.reset(jax.random.key(0))
    key = jax.random.key(1)
    ours, theirs = (bridge.step(key, state, action)[0] for action in (jnp.array([0.5]), jnp.array(0.5)))
    np.testing.assert_array_equal(ours, theirs)
    assert np.any(ours != obs)


def test_it_scans_on_mjx():
    """Traced, not compiled: that takes most of the time."""
    bridge = envs.as_gymnax(compiled("InvertedPendulum", "mjx").env)

    def run(keys):
        body = lambda s, _: (jax.vmap(bridge.step)(keys, s, jnp.zeros((2, 1)))[1], None)  # noqa: E731
        return jax.lax.scan(body, jax.vmap(bridge.reset)(keys)[1], None, 5)[0]

    assert jax.eval_shape(run, jax.random.split(jax.random.key(0), 2)).obs.shape == (2, 4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what rejax imports
def test_rejax_trains_on_it(bridge):
    """Falling takes a random policy some ten steps."""
    from rejax import PPO

    params = bridge.default_params.replace(max_steps_in_episode=100)
    algorithm = PPO.create(
        env=bridge,
        env_params=params,
        agent_kwargs={"activation": "tanh"},
        total_timesteps=65_536,
        eval_freq=32_768,
        num_envs=64,
        num_steps=64,
        num_epochs=8,
        num_minibatches=8,
        learning_rate=1e-3,
        gamma=0.98,
        gae_lambda=0.95,
        ent_coef=0.0,
    )
    with jax.numpy_rank_promotion("allow"):  # rejax broadcasts across ranks
        _, (lengths, returns) = jax.jit(algorithm.train)(jax.random.PRNGKey(0))
    np.testing.assert_array_equal(lengths, returns)
    returns = returns.mean(axis=1)
    assert returns[0] < 40 and returns[-1] > 70, returns
