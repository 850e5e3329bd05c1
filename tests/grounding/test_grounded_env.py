"""The grounded simulator as an environment: which transformer acts, what is charged, what stays the same."""

import copy

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from mpge_jax.grounding.grounded_env import GroundedEnv
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


def test_transformers_of_another_task_are_refused_where_they_are_given():
    pendulum, cheetah = small.env("InvertedPendulum"), small.env("HalfCheetah")
    with pytest.raises(ValueError, match="of another task: they take 5 numbers, but HalfCheetah has 17 obs"):
        GroundedEnv(cheetah, small.constant(pendulum, 0.0))
    with pytest.raises(ValueError, match="needs transformers, as `ground` returns them, not None"):
        GroundedEnv(pendulum, None)


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


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
@pytest.mark.parametrize("wrap", [lambda env: env, envs.AutoReset])
def test_a_copy_steps_as_the_original(wrap, copied):
    env = small.env("InvertedPendulum")
    grounded = wrap(GroundedEnv(env, small.constant(env, 0.5)))
    again = copied(grounded)
    assert again.max_steps == 1000 and type(again) is type(grounded)
    state = grounded.reset(jax.random.key(0))
    ours, theirs = grounded.step(state, jnp.ones(1)), again.step(state, jnp.ones(1))
    np.testing.assert_array_equal(ours.obs, theirs.obs)


def test_brax_draws_a_member_for_each_episode_too(pendulum):
    """brax's auto-reset puts back the physics and the observation, and no info."""
    from brax.envs.wrappers import training

    env = training.wrap(envs.as_brax(pendulum), episode_length=2)

    @jax.jit
    def rollout(key):
        first = env.reset(jax.random.split(key, 16))

        def body(state, _):
            after = env.step(state, jnp.full((16, 1), 0.25))
            own = after.info["env"]
            return after, (state.obs, own["member"], own["next_obs"], after.done)

        return first, jax.lax.scan(body, first, None, 24)[1]

    first, (obs, member, following, done) = jax.tree.map(np.asarray, rollout(jax.random.PRNGKey(0)))
    np.testing.assert_array_equal(done, np.tile([0.0, 1.0], 12)[:, None] * np.ones(16))
    np.testing.assert_array_equal(member[0], first.info["env"]["member"])
    episodes = member.reshape(12, 2, 16)
    np.testing.assert_array_equal(episodes, episodes[:, :1] + np.zeros((1, 2, 1), int))
    # Two in three of the 176 episodes that follow another get another member.
    assert 0.5 < np.mean(episodes[1:, 0] != episodes[:-1, 0]) < 0.85
    executed = 0.25 + np.asarray(DELTAS)[member.reshape(-1)]
    reached = small.step_from("InvertedPendulum", obs.reshape(-1, 4), executed[:, None].astype(np.float32))
    np.testing.assert_allclose(following.reshape(-1, 4), reached, atol=2e-5)


def test_in_brax_without_wrappers_the_member_drawn_at_reset_stays(pendulum):
    bridge = envs.as_brax(pendulum)
    for make_key in (jax.random.key, jax.random.PRNGKey):
        first = jax.vmap(bridge.reset)(jax.random.split(make_key(0), 16))
        after, members = jax.lax.scan(
            lambda state, _: (jax.vmap(bridge.step)(state, jnp.zeros((16, 1))), state.info["env"]["member"]),
            first,
            None,
            5,
        )
        assert len(np.unique(members[0])) == 3
        np.testing.assert_array_equal(members, np.broadcast_to(first.info["env"]["member"], (5, 16)))
        np.testing.assert_array_equal(after.info["env"]["steps"], np.full(16, 5))


@pytest.mark.parametrize("name", ["InvertedPendulum", pytest.param("Hopper", marks=pytest.mark.slow)])
def test_brax_wrappers_carry_mjx_data(name):
    """Traced, not compiled: that takes most of the time. The pendulum has no contacts to carry."""
    from brax.envs.wrappers import training

    mjx = envs.make(name, "mjx")
    grounded = GroundedEnv(mjx, small.constant(mjx, 0.1))
    env = training.wrap(envs.as_brax(grounded), episode_length=4)

    def run(key):
        first = env.reset(jax.random.split(key, 2))
        return jax.lax.scan(
            lambda s, _: (env.step(s, jnp.zeros((2, mjx.action_size))), None), first, None, 5
        )[0]

    last = jax.eval_shape(run, jax.random.PRNGKey(0))
    assert last.obs.shape == (2, mjx.observation_size) and last.info["env"]["member"].shape == (2,)


@pytest.mark.slow
@pytest.mark.usefixtures("brax_on_new_jax")
def test_brax_ppo_trains_on_a_grounded_simulator():
    """Falling takes a random policy some ten steps; the members push by -0.2, 0 and 0.2."""
    from brax.training.agents.ppo import train as ppo

    env = small.env("InvertedPendulum")
    grounded = GroundedEnv(env, small.stacked(*(small.constant(env, delta) for delta in (-0.2, 0.0, 0.2))))
    returns = []
    with jax.numpy_rank_promotion("allow"):  # brax broadcasts across ranks
        ppo.train(
            envs.as_brax(grounded),
            num_timesteps=60_000,
            episode_length=100,
            num_envs=64,
            num_eval_envs=64,
            num_evals=4,
            learning_rate=1e-3,
            discounting=0.98,
            unroll_length=10,
            batch_size=64,
            num_minibatches=4,
            num_updates_per_batch=8,
            normalize_observations=True,
            log_training_metrics=False,
            progress_fn=lambda _, metrics: returns.append(float(metrics["eval/episode_reward"])),
        )
    assert returns[0] < 40 and returns[-1] > 70, returns
