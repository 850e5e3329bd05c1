"""AutoReset, and what all wrappers share."""

import copy
import pickle
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, compiled


@pytest.fixture(scope="module")
def falling():
    """Pendulums pushed until some have fallen: the state before, the action, and the step with and without a reset."""
    case = compiled("InvertedPendulum")
    env = envs.AutoReset(case.env)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), COPIES))
    step = jax.jit(jax.vmap(env.step))
    pushes = jnp.array([[3.0], [0.5], [-2.0], [0.0]])
    for _ in range(100):
        before, state = state, step(state, pushes)
        if state.done.any():
            plain = before.replace(info={k: v for k, v in before.info.items() if k != "key"})
            return env, step, before, pushes, state, case.step(plain, pushes)
    raise AssertionError("nothing fell in 100 steps")


def test_auto_reset_keeps_the_true_next_observation(falling):
    _, _, before, _, after, plain = falling
    ended = np.asarray(plain.done) > 0
    assert ended.any() and not ended.all()
    np.testing.assert_array_equal(after.info["next_obs"], plain.obs)
    for name in ("terminated", "truncated"):
        np.testing.assert_array_equal(after.info[name], plain.info[name])
    np.testing.assert_array_equal(after.done, plain.done)
    np.testing.assert_array_equal(after.reward, plain.reward)
    assert np.all(np.abs(plain.obs[ended, 1]) > 0.2)

    np.testing.assert_array_equal(after.obs[~ended], plain.obs[~ended])
    assert np.all(np.abs(after.obs[ended]) <= 0.01)
    np.testing.assert_array_equal(after.data.qpos[ended], after.obs[ended, :2])
    np.testing.assert_array_equal(after.data.time[ended], 0.0)
    np.testing.assert_array_equal(after.data.qpos[~ended], plain.data.qpos[~ended])
    np.testing.assert_array_equal(after.info["steps"], np.where(ended, 0, before.info["steps"] + 1))


def test_auto_reset_draws_a_new_start_every_time(falling):
    _, step, before, pushes, after, _ = falling
    ended = np.flatnonzero(after.done)[0]
    again = before.replace(info={**before.info, "key": after.info["key"]})
    assert np.any(np.asarray(step(again, pushes).obs[ended]) != np.asarray(after.obs[ended]))
    keys = jax.random.key_data(after.info["key"])
    assert np.all(keys != jax.random.key_data(before.info["key"]))


def test_terminated_and_truncated_apart(falling):
    """Fallen, out of time, both and neither, in one batch."""
    _, step, before, pushes, _, _ = falling
    angle = jnp.array([0.5, 0.0, 0.5, 0.0])
    steps = jnp.array([3, 999, 999, 3], jnp.int32)
    data = before.data.replace(qpos=jnp.stack([jnp.zeros(4), angle], axis=1), qvel=jnp.zeros((4, 2)))
    state = step(before.replace(data=data, info={**before.info, "steps": steps}), 0.0 * pushes)
    np.testing.assert_array_equal(state.info["terminated"], [1, 0, 1, 0])
    np.testing.assert_array_equal(state.info["truncated"], [0, 1, 1, 0])
    np.testing.assert_array_equal(state.done, [1, 1, 1, 0])
    np.testing.assert_array_equal(state.info["steps"], [0, 0, 0, 4])
    assert np.all(np.abs(state.info["next_obs"][jnp.array([0, 2]), 1]) > 0.2)


def test_auto_reset_scans(falling):
    """Its state can be carried: the key, the counters and the physics keep their types."""
    env, _, before, _, _, _ = falling
    one = jax.tree.map(lambda x: x[0], before)

    def push(state, _):
        state = env.step(state, jnp.full(1, 3.0))
        return state, (state.done, state.info["next_obs"][1], state.obs[1])

    done, true_angle, angle = jax.jit(lambda s: jax.lax.scan(push, s, None, 60))(one)[1]
    assert done.sum() >= 2
    np.testing.assert_array_equal(done, np.abs(true_angle) > 0.2)
    assert np.abs(angle).max() <= 0.2


def test_what_is_learned_from_stays_finite(falling):
    """A copy that diverges, of two: its row ends the episode where it was, and the other's is untouched."""
    env, _, before, _, _, _ = falling
    two = jax.tree.map(lambda x: x[:2], before)
    qvel = two.data.qvel.at[0].set(jnp.nan)
    after = jax.vmap(env.step)(two.replace(data=two.data.replace(qvel=qvel)), jnp.zeros((2, 1)))
    np.testing.assert_array_equal(after.info["next_obs"][0], two.obs[0])
    np.testing.assert_array_equal(after.info["terminated"], [1, 0])
    assert after.reward[0] == 0 and after.reward[1] == 1
    assert np.isfinite(after.obs).all() and np.any(after.obs[0] != two.obs[0])
    np.testing.assert_array_equal(after.info["next_obs"][1], after.obs[1])


def test_attributes_pass_through(falling):
    env = falling[0]
    assert (env.name, env.observation_size, env.action_size, env.max_steps) == (
        "InvertedPendulum",
        4,
        1,
        1000,
    )


@pytest.mark.parametrize("copied", [copy.copy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_wrapper_is_copied_with_what_it_wraps(copied):
    wrapped = copied(envs.AutoReset(envs.AutoReset(SimpleNamespace(max_steps=7))))
    assert wrapped.max_steps == 7
    for name in ("no_such_thing", "_private"):
        with pytest.raises(AttributeError, match=name):
            getattr(wrapped, name)


@pytest.mark.parametrize("name", ["InvertedPendulum", pytest.param("Hopper", marks=pytest.mark.slow)])
def test_auto_reset_scans_on_mjx(name):
    """Traced, not compiled: that takes most of the time. The pendulum has no contacts, so empty arrays to carry."""
    env = envs.AutoReset(compiled(name, "mjx").env)
    action = jnp.zeros(env.action_size)

    def run(key):
        return jax.lax.scan(lambda state, _: (env.step(state, action), None), env.reset(key), None, 5)[0]

    last = jax.eval_shape(jax.vmap(run), jax.random.split(jax.random.key(0), 2))
    assert last.obs.shape == (2, env.observation_size)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["InvertedPendulum", "Hopper", "HalfCheetah"])
def test_auto_reset_on_mjx(name):
    case = compiled(name, "mjx")
    env = envs.AutoReset(case.env)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), COPIES))
    steps = jnp.array([5, 999, 5, 999], jnp.int32)
    state = state.replace(info={**state.info, "steps": steps})
    after = jax.jit(jax.vmap(env.step))(state, case.actions())
    plain = case.step(state.replace(info={k: v for k, v in state.info.items() if k != "key"}), case.actions())
    np.testing.assert_array_equal(after.done, [0, 1, 0, 1])
    np.testing.assert_allclose(after.info["next_obs"], plain.obs, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(after.data.time[jnp.array([1, 3])], 0.0)
    assert np.any(np.asarray(after.obs[1]) != np.asarray(plain.obs[1]))
