"""What every environment promises, on every engine that runs on this machine."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, NAMES, compiled

# MJX takes tens of seconds to compile a model on CPU: one of its models by default, all of them in the slow tests.
CASES = [(name, "c") for name in NAMES] + [
    pytest.param(name, "mjx", marks=[] if name == "InvertedPendulum" else pytest.mark.slow) for name in NAMES
]
SIZES = {"InvertedPendulum": (4, 1, 3.0), "Hopper": (11, 3, 1.0), "HalfCheetah": (17, 6, 1.0)}

over_registry = pytest.mark.parametrize(("name", "backend"), CASES)


def assert_same(one, two, rows=slice(None)):
    jax.tree.map(
        lambda a, b: np.testing.assert_array_equal(np.asarray(a)[rows], np.asarray(b)[rows]), one, two
    )


def types_of(state):
    return [(x.shape, x.dtype) for x in jax.tree.leaves(state)]


def test_engines_step_alike():
    """MJX in float32, 4e-5 apart at most over 256 states; the slow tests compare the other tasks with Gymnasium."""
    one, other = (compiled("InvertedPendulum", backend) for backend in ("c", "mjx"))
    state = one.step(one.start(), one.actions(1))
    same = jax.jit(jax.vmap(other.env.state_from_obs))(state.obs)
    ours, theirs = one.step(state, one.actions(2)), other.step(same, one.actions(2))
    assert np.abs(np.asarray(ours.obs - state.obs)).max() > 0.05
    np.testing.assert_allclose(theirs.obs, ours.obs, atol=1e-4)
    np.testing.assert_array_equal(theirs.reward, ours.reward)
    np.testing.assert_array_equal(theirs.info["terminated"], ours.info["terminated"])


@pytest.mark.parametrize("name", NAMES)
def test_attributes(name):
    env = compiled(name, "c").env
    observation_size, action_size, limit = SIZES[envs.source_of(name)]
    assert (env.name, env.max_steps) == (name, 1000)
    assert (env.observation_size, env.action_size) == (observation_size, action_size)
    np.testing.assert_array_equal(env.action_high, np.full(action_size, limit, np.float32))
    np.testing.assert_array_equal(env.action_low, -env.action_high)


@over_registry
def test_shapes(name, backend):
    """A step changes no shape and no type: a state can be carried by `jax.lax.scan`."""
    env, _, step = case = compiled(name, backend)
    first = case.start()
    after = step(first, case.actions())
    assert types_of(first) == types_of(after)
    assert after.obs.shape == (COPIES, env.observation_size)
    for value in (
        after.reward,
        after.done,
        after.info["terminated"],
        after.info["truncated"],
        *after.metrics.values(),
    ):
        assert value.shape == (COPIES,) and value.dtype == jnp.float32
    assert_same(first.info["steps"], np.zeros(COPIES))
    assert_same(after.info["steps"], np.ones(COPIES))
    assert_same(after.info["next_obs"], after.obs)
    assert not first.done.any() and not first.reward.any()
    assert np.isfinite(after.obs).all() and np.isfinite(after.reward).all()
    parts = sum(after.metrics.values(), jnp.zeros(COPIES))
    alive = 0.0 if envs.source_of(name) == "HalfCheetah" else 1.0
    np.testing.assert_allclose(after.reward, parts + alive, atol=1e-5)


@over_registry
def test_the_key_determines_everything(name, backend):
    case = compiled(name, backend)
    first = case.start()
    after = case.step(first, case.actions())
    case.step(after, -case.actions(1))  # an engine that remembered this would step differently below
    assert_same(case.start(), first)
    assert_same(case.step(first, case.actions()), after)
    assert len(np.unique(np.asarray(first.obs), axis=0)) == COPIES
    other = case.reset(jax.random.split(jax.random.key(1), COPIES))
    assert not np.any(np.all(np.asarray(other.obs) == np.asarray(first.obs), axis=1))


@over_registry
def test_copies_do_not_touch_each_other(name, backend):
    case = compiled(name, backend)
    first, actions = case.start(), case.actions()
    others = np.array([0, 2, 3])
    after = case.step(first, actions)

    moved = case.step(first, actions.at[1].multiply(-1.0))
    assert_same(moved, after, others)
    assert np.any(np.asarray(moved.obs[1]) != np.asarray(after.obs[1]))

    lost_action = case.step(first, actions.at[1].set(jnp.nan))
    lost_state = case.step(
        first.replace(data=first.data.replace(qvel=first.data.qvel.at[1].set(jnp.nan))), actions
    )
    for lost in (lost_action, lost_state):
        assert_same(lost.obs, after.obs, others)
        assert_same(lost.reward, after.reward, others)
        # What is lost stays lost, for all to see, and ends its episode.
        assert np.isnan(lost.obs[1]).any() and lost.reward[1] == 0
        assert_same(lost.done, [0.0, 1.0, 0.0, 0.0])
        again = case.step(lost, actions)
        assert np.isnan(again.obs[1]).any() and np.isfinite(np.asarray(again.obs)[others]).all()


@pytest.mark.parametrize("name", NAMES)
def test_one_environment_is_a_row_of_many(name):
    case = compiled(name, "c")
    first, actions = case.start(), case.actions()
    row = jax.tree.map(lambda x: x[2], first)
    assert_same(jax.jit(case.env.step)(row, actions[2]).obs, case.step(first, actions).obs[2])


def test_nested_vmap():
    case = compiled("Hopper", "c")
    first, actions = case.start(), case.actions()
    nest = lambda x: x.reshape(2, 2, *x.shape[1:])  # noqa: E731
    nested = jax.jit(jax.vmap(jax.vmap(case.env.step)))(jax.tree.map(nest, first), nest(actions))
    assert_same(nested.obs, nest(case.step(first, actions).obs))


def test_actions_are_clipped_to_the_box():
    case = compiled("Hopper", "c")
    first, actions = case.start(), case.actions()
    bounded = case.step(first, jnp.sign(actions))
    assert_same(case.step(first, 7.0 * jnp.sign(actions)).obs, bounded.obs)


@over_registry
def test_state_from_obs(name, backend):
    """The rebuilt state has the observation, and goes on as the original does."""
    case = compiled(name, backend)
    env, state = case.env, case.start()
    rebuilt = jax.jit(jax.vmap(env.state_from_obs))(state.obs)
    assert_same(rebuilt.obs, state.obs)
    assert types_of(rebuilt) == types_of(state)
    one, two = case.step(state, case.actions()), case.step(rebuilt, case.actions())
    # MJX in single precision: with the root elsewhere its contacts are rounded otherwise.
    tolerance = 1e-6 if backend == "c" else 5e-5
    np.testing.assert_allclose(one.obs, two.obs, rtol=tolerance, atol=tolerance)
    # The root's position is lost, and with it a few bits of its velocity.
    np.testing.assert_allclose(one.reward, two.reward, atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_states_are_told_but_where_an_observation_cuts_them_off(name):
    """All of a first state but where a root is; and of ten times its speeds, but of a Hopper's beyond 10."""
    case = compiled(name)
    env, state = case.env, case.start()
    on_rail = env.task.name == "InvertedPendulum"
    assert np.flatnonzero(~env.observed).tolist() == ([] if on_rail else [0])
    told = jax.jit(jax.vmap(env.tells_state))
    assert np.all(told(state.obs))
    sizes = jnp.array([0.5, 9.9, 10.0, 10.1])
    qvel = state.data.qvel.at[:, -1].set(jnp.array([1, -1, 1, -1]) * sizes)
    fast = jax.vmap(lambda q, v: env.task.observe(env.engine.init(q, v)))(state.data.qpos, qvel)
    expected = [True, True, False, False] if "hopper" in name.lower() else [True] * 4
    assert np.asarray(told(fast)).tolist() == expected


def test_bounds_on_either_side_are_told_wherever_episodes_begin():
    """Speeds clipped to 0 to 1: at a bound one side alone is followed. Resets on the bound hide no coordinate."""
    task = compiled("InvertedPendulum").env.task
    clipped = replace(
        task,
        observe=lambda d: jnp.concatenate([d.qpos, jnp.clip(d.qvel, 0.0, 1.0)]),
        reset=lambda key: (jnp.zeros(2), jnp.array([1.0, 0.5])),
    )
    env = envs.Env(clipped, model := envs.build_model(clipped), envs.engine_of(model, "c"))
    assert env.observed.all()
    for speed, told in ((0.0, False), (0.5, True), (1.0, False)):
        assert bool(env.tells_state(jnp.array([0.1, 0.0, 0.5, speed]))) == told


@over_registry
def test_reset_after_done(name, backend):
    case = compiled(name, backend)
    first = case.start()
    state = first.replace(info={**first.info, "steps": first.info["steps"] + 999})
    last = case.step(state, jnp.zeros_like(case.actions()))
    assert_same(last.info["truncated"], np.ones(COPIES))
    assert_same(last.info["terminated"], np.zeros(COPIES))
    assert_same(last.done, np.ones(COPIES))
    assert_same(case.start(), first)


@pytest.mark.parametrize(
    ("name", "known"),
    [("hopper", "Hopper"), ("BrokenChetah", "BrokenCheetah"), ("InvertedPendulm", "InvertedPendulum")],
)
def test_unknown_environment(name, known):
    with pytest.raises(ValueError, match=f"unknown environment '{name}'; did you mean '{known}'"):
        envs.make(name)


def test_what_is_like_no_name_gets_a_short_list_and_no_guess():
    with pytest.raises(
        ValueError, match=r"unknown environment 'Nope' \(known: Inv.*, hopper-\.\.\. \(ODRL\)\)$"
    ) as e:
        envs.make("Nope")
    assert len(str(e.value)) < 400


def test_unknown_backend_and_dynamics():
    with pytest.raises(ValueError, match="unknown backend 'mjc'; did you mean 'mjx'"):
        envs.make("Hopper", backend="mjc")
    with pytest.raises(ValueError, match="unknown dynamics 'legasy'; did you mean 'legacy'"):
        envs.make("Hopper", dynamics="legasy")


def test_wrong_shapes():
    env = compiled("Hopper", "c").env
    state = env.reset(jax.random.key(0))
    with pytest.raises(ValueError, match=r"Hopper.step wants an action of shape \(3,\), got \(4, 3\)"):
        env.step(state, jnp.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"shape \(3,\), got \(1,\)"):
        env.step(state, jnp.zeros(3), charged=jnp.zeros(1))
    with pytest.raises(ValueError, match=r"observations of shape \(11,\), got \(12,\)"):
        env.state_from_obs(jnp.zeros(12))
