"""MuJoCo Playground's wrappers on our environments, and brax's PPO behind them."""

import importlib.util
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from mpge_jax import GroundedEnv
from tests import small
from tests.envs.compiled import COPIES, compiled

installed = importlib.util.find_spec("mujoco_playground") is not None


@pytest.fixture
def playground():
    return pytest.importorskip("mujoco_playground")


def grounded():
    env = small.env("InvertedPendulum")
    return GroundedEnv(env, small.stacked(small.constant(env, 0.5), small.constant(env, -0.5)))


def test_without_it_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_playground", None)
    with pytest.raises(ImportError, match="not installed: pip install playground"):
        envs.as_playground(compiled("InvertedPendulum").env)


@pytest.mark.slow
def test_it_is_an_environment_of_theirs(playground):
    ours = compiled("InvertedPendulum")
    bridge = envs.as_playground(ours.env)
    assert isinstance(bridge, playground.MjxEnv) and bridge.unwrapped is bridge
    assert (bridge.observation_size, bridge.action_size) == (4, 1)
    assert (bridge.dt, bridge.sim_dt, bridge.n_substeps) == (0.04, 0.02, 2)
    assert bridge.mj_model is ours.env.model and bridge.mjx_model.nq == 2
    assert bridge.xml_path.rstrip("/").endswith("assets")
    state = jax.jit(bridge.reset)(jax.random.PRNGKey(0))
    assert isinstance(state, playground.State)
    after = jax.jit(bridge.step)(state, jnp.ones(1))
    np.testing.assert_allclose(after.obs, ours.env.predict(state.obs, jnp.ones(1)), atol=1e-6)
    assert jax.tree.structure(after) == jax.tree.structure(state)


@pytest.mark.slow
@pytest.mark.parametrize("full_reset", [False, True])
def test_their_wrappers(playground, full_reset):
    """Episode, vmap and auto-reset wrappers with a time limit of 20 steps: pushed copies fall, others are cut."""
    env = playground.wrapper.wrap_for_brax_training(
        envs.as_playground(grounded()), episode_length=20, full_reset=full_reset
    )
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), COPIES))
    first, step = state, jax.jit(env.step)
    pushes = jnp.array([[3.0], [0.0], [0.0], [0.0]])
    fallen = truncated = 0
    members, steps = [], []
    for _ in range(42):
        state = step(state, pushes)
        fallen += np.asarray(state.done) * (1 - np.asarray(state.info["truncation"]))
        truncated += np.asarray(state.info["truncation"])
        ended = np.asarray(state.done) > 0
        assert np.all(state.obs[ended] == first.obs[ended]) != full_reset or not ended.any()
        members.append(np.asarray(state.info["env"]["member"]))
        steps.append(np.asarray(state.info["env"]["steps"]))
    assert fallen[0] >= 1
    # Episodes count anew after each end, and not all have one member.
    assert np.max(steps) <= 20 and len(np.unique(members)) == 2
    assert np.all(fallen + truncated >= 2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("kind", ["playground", "brax"])
@pytest.mark.usefixtures("brax_on_new_jax")
def test_brax_trains_in_it(request, kind):
    """Falling takes a random policy some ten steps."""
    from brax.training.agents.ppo import train as ppo

    env, options = envs.as_brax(grounded()), {}
    if kind == "playground":
        wrapper = request.getfixturevalue("playground").wrapper
        env, options = envs.as_playground(grounded()), {"wrap_env_fn": wrapper.wrap_for_brax_training}
    returns = []
    with jax.numpy_rank_promotion("allow"):  # brax broadcasts across ranks
        ppo.train(
            environment=env,
            num_timesteps=12_000,
            episode_length=100,
            num_envs=16,
            num_evals=2,
            num_eval_envs=8,
            learning_rate=1e-3,
            discounting=0.95,
            unroll_length=16,
            batch_size=16,
            num_minibatches=8,
            num_updates_per_batch=10,
            entropy_cost=0.0,
            normalize_observations=True,
            progress_fn=lambda _, metrics: returns.append(float(metrics["eval/episode_reward"])),
            **options,
        )
    assert returns[0] < 20 and returns[-1] > 3 * returns[0], returns
