"""brax's own wrappers on our environments."""

import jax
import jax.numpy as jnp
import numpy as np

import envs
from tests.envs.compiled import COPIES, compiled


def test_brax_wrappers():
    """Episode, vmap and auto-reset wrappers of brax, with a time limit of 20 steps."""
    from brax.envs.wrappers import training

    ours = compiled("InvertedPendulum")
    bridge = envs.as_brax(ours.env)
    assert (bridge.observation_size, bridge.action_size, bridge.backend) == (4, 1, "mujoco")
    env = training.wrap(bridge, episode_length=20)
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), COPIES))
    first, step = state, jax.jit(env.step)
    pushes = jnp.array([[3.0], [0.0], [0.0], [0.0]])
    fallen = truncated = 0
    for count in range(1, 21):
        state = step(state, pushes)
        np.testing.assert_array_equal(state.reward, np.ones(COPIES))
        fallen += np.asarray(state.done)
        truncated += np.asarray(state.info["truncation"])
        ended = np.asarray(state.done) > 0
        np.testing.assert_array_equal(state.obs[ended], first.obs[ended])  # brax starts every episode alike
        if count == 1:
            keys = jax.random.split(jax.random.PRNGKey(0), COPIES)
            plain = ours.step(ours.reset(jax.vmap(jax.random.split)(keys)[:, 1]), pushes)
            np.testing.assert_array_equal(state.obs, plain.obs)
    assert fallen[0] >= 1 and truncated[0] == 0
    np.testing.assert_array_equal(fallen[1:], np.ones(COPIES - 1))
    np.testing.assert_array_equal(truncated[1:], np.ones(COPIES - 1))


def test_a_metric_that_a_wrapper_adds_is_kept():
    """EvalWrapper adds `reward`; EpisodeWrapper's scan fails if a step drops it."""
    from brax.envs.wrappers import training

    env = training.EvalWrapper(training.wrap(envs.as_brax(compiled("HalfCheetah").env), 3, action_repeat=2))
    state = env.reset(jax.random.split(jax.random.PRNGKey(0), 2))
    names = {"reward", "reward_run", "reward_control"}
    assert set(state.metrics) == names
    rewards = 0.0
    for _ in range(2):
        state = env.step(state, jnp.zeros((2, 6)))
        assert set(state.metrics) == names
        rewards += np.asarray(state.reward)
    np.testing.assert_allclose(state.info["eval_metrics"].episode_metrics["reward"], rewards, rtol=1e-6)


def test_the_steps_of_an_episode_start_again_with_it():
    """Two episodes of three steps under brax's auto-reset, which puts back the physics alone."""
    from brax.envs.wrappers import training

    env = training.wrap(envs.as_brax(compiled("InvertedPendulum").env), episode_length=3)
    state = env.reset(jax.random.split(jax.random.PRNGKey(0), 2))
    first, steps = state, []
    for count in range(1, 7):
        state = env.step(state, jnp.zeros((2, 1)))
        steps.append(int(state.info["env"]["steps"][0]))
        assert float(state.info["steps"][0]) == (count - 1) % 3 + 1
        if count == 4:
            reached = compiled("InvertedPendulum").env.predict(first.obs[0], jnp.zeros(1))
            np.testing.assert_allclose(state.info["env"]["next_obs"][0], reached, atol=1e-6)
    assert steps == [1, 2, 3, 1, 2, 3]
