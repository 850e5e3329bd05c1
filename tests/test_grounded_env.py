"""The grounded simulator as an environment: which transformer acts, what is charged, what stays the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from mpge_jax.grounded_env import GroundedEnv
from tests import small

DELTAS = (-1.0, 0.5, 1.5)


@pytest.fixture(scope="module")
def pendulum():
    env = small.env("InvertedPendulum")
    return GroundedEnv(env, small.stacked(*(small.constant(env, delta) for delta in DELTAS)))


def test_the_member_is_drawn_at_reset_and_acts_until_the_next(pendulum):
    wrapped = envs.AutoReset(pendulum)

    @jax.jit
    def rollout(key):
        first = jax.vmap(wrapped.reset)(jax.random.split(key, 6))

        def body(state, _):
            after = jax.vmap(wrapped.step)(state, jnp.full((6, 1), 0.25))
            return after, (state.obs, state.info["member"], after.info["next_obs"], after.done)

        return jax.lax.scan(body, first, None, 40)[1]

    obs, member, following, done = map(np.asarray, rollout(jax.random.key(0)))
    assert set(np.unique(member[0])) <= {0, 1, 2} and set(np.unique(member)) == {0, 1, 2}
    over = done[:-1] > 0
    np.testing.assert_array_equal(member[1:][~over], member[:-1][~over])
    assert 0.3 < np.mean(member[1:][over] != member[:-1][over]) < 1.0
    # Each member's own change of the action is what happened.
    executed = 0.25 + np.asarray(DELTAS)[member.reshape(-1)]
    reached = small.step_from("InvertedPendulum", obs.reshape(-1, 4), executed[:, None].astype(np.float32))
    np.testing.assert_allclose(following.reshape(-1, 4), reached, atol=2e-5)


def test_one_transformer_is_an_ensemble_of_one(pendulum):
    env = small.env("InvertedPendulum")
    single = GroundedEnv(env, small.constant(env, 1.5))
    state = single.reset(jax.random.key(0))
    assert int(state.info["member"]) == 0
    after = single.step(state, jnp.array([0.25]))
    reached = env.step(env.state_from_obs(state.obs), jnp.array([1.75]))
    np.testing.assert_allclose(after.obs, reached.obs, atol=1e-6)


def test_a_state_from_an_observation_is_grounded_by_the_member_named(pendulum):
    obs = np.array([0.01, 0.02, -0.1, 0.3], np.float32)
    for member, delta in enumerate(DELTAS):
        after = pendulum.step(pendulum.state_from_obs(jnp.asarray(obs), member), jnp.array([0.25]))
        reached = small.step_from("InvertedPendulum", obs[None], np.array([[0.25 + delta]], np.float32))[0]
        np.testing.assert_allclose(after.obs, reached, atol=1e-6)
        np.testing.assert_allclose(
            pendulum.predict(jnp.asarray(obs), jnp.array([0.25]), member), reached, atol=1e-6
        )


def test_the_same_state_and_action_give_the_same_step(pendulum):
    state = pendulum.reset(jax.random.key(1))
    first, second = (pendulum.step(state, jnp.array([0.3])) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, first, second)


def test_the_agent_pays_for_the_action_it_asked_for():
    env = small.env("HalfCheetah")
    grounded = GroundedEnv(env, small.constant(env, [-0.5, 0.0, 0.0, 0.0, 0.0, 0.25]))
    action = jnp.array([0.5, 0.2, -0.1, 0.0, 0.3, 0.4])
    state = grounded.reset(jax.random.key(0))
    after = grounded.step(state, action)
    plain = env.step(env.state_from_obs(state.obs), action + jnp.array([-0.5, 0.0, 0.0, 0.0, 0.0, 0.25]))
    np.testing.assert_allclose(after.metrics["reward_control"], -0.1 * np.sum(np.square(action)), rtol=1e-5)
    np.testing.assert_allclose(after.metrics["reward_run"], plain.metrics["reward_run"], atol=1e-4)
    np.testing.assert_allclose(
        after.reward, after.metrics["reward_run"] + after.metrics["reward_control"], rtol=1e-5
    )
    assert abs(float(plain.metrics["reward_control"] - after.metrics["reward_control"])) > 1e-3


def test_an_action_beyond_the_box_is_clipped_before_it_is_transformed():
    env = small.env("InvertedPendulum")
    grounded = GroundedEnv(env, small.constant(env, -1.0))
    state = grounded.reset(jax.random.key(0))
    np.testing.assert_array_equal(
        grounded.step(state, jnp.array([7.0])).obs, grounded.step(state, jnp.array([3.0])).obs
    )


def test_it_looks_like_every_other_environment(pendulum):
    env = small.env("InvertedPendulum")
    for name in ("name", "observation_size", "action_size", "max_steps"):
        assert getattr(pendulum, name) == getattr(env, name)
    np.testing.assert_array_equal(pendulum.action_high, env.action_high)
    state = jax.eval_shape(pendulum.reset, jax.random.key(0))
    after = jax.eval_shape(pendulum.step, state, jax.ShapeDtypeStruct((1,), jnp.float32))
    assert jax.tree.structure(state) == jax.tree.structure(after)
    with pytest.raises(ValueError, match="was it made for another task"):
        cheetah = GroundedEnv(small.env("HalfCheetah"), small.constant(env, 0.0))
        jax.eval_shape(lambda key: cheetah.step(cheetah.reset(key), jnp.zeros(6)), jax.random.key(0))
