"""The tasks against Gymnasium's v4: physics, rewards, terminations, resets."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, compiled

ROOT = Path(__file__).resolve().parents[2]
TASKS = ("InvertedPendulum", "Hopper", "HalfCheetah")


@pytest.fixture(scope="module")
def theirs():
    """Gymnasium's environments, without the wrappers of `gymnasium.make`."""
    with warnings.catch_warnings():
        # v4 is what the paper's v2 became; that there is a v5 changes nothing here.
        warnings.filterwarnings("ignore", ".*The environment .* is out of date", DeprecationWarning)
        return {name: gymnasium.make(f"{name}-v4").unwrapped for name in TASKS}


def their_step(env, qpos, qvel, action):
    mujoco.mj_resetData(env.model, env.data)
    env.set_state(np.asarray(qpos, np.float64), np.asarray(qvel, np.float64))
    return env.step(np.asarray(action, np.float64))


@pytest.fixture(scope="module")
def start():
    """States a few random steps into an episode (feet on the ground), and actions."""

    def build(name):
        case = compiled(name)
        state = case.start()
        for seed in range(10):
            state = case.step(state, case.actions(seed))
        return jax.jit(jax.vmap(case.env.state_from_obs))(state.obs), case.actions(99)

    return {name: build(name) for name in TASKS}


# MJX solves the same equations in float32, contacts included. Largest differences between the two engines' observations
# over 256 states of random episodes: 4e-5 (InvertedPendulum), 2e-5 (Hopper), 4e-4 (HalfCheetah; 2e-4 of the value).
TOLERANCE = {
    "c": dict.fromkeys(TASKS, 2e-6),
    "mjx": {"InvertedPendulum": 1e-4, "Hopper": 1e-4, "HalfCheetah": 1e-3},
}


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        *((name, "c") for name in TASKS),
        # The contract holds one of them to the C engine, where it is compiled anyway.
        *(pytest.param(name, "mjx", marks=pytest.mark.slow) for name in TASKS),
    ],
)
def test_one_step(name, backend, theirs, start):
    case, (state, actions) = compiled(name, backend), start[name]
    if backend == "mjx":
        state = jax.jit(jax.vmap(case.env.state_from_obs))(state.obs)
    after = case.step(state, actions)
    tolerance = TOLERANCE[backend][name]
    for i in range(COPIES):
        obs, reward, terminated, _, _ = their_step(
            theirs[name], state.data.qpos[i], state.data.qvel[i], actions[i]
        )
        np.testing.assert_allclose(after.obs[i], obs, rtol=tolerance, atol=tolerance)
        # A position difference over 0.008 s (Hopper) to 0.05 s (HalfCheetah).
        np.testing.assert_allclose(after.reward[i], reward, atol=20 * tolerance)
        assert bool(after.info["terminated"][i]) == terminated


def test_a_thousand_steps_in_float64():
    """Bits of physics: every step but the first builds on the last, through contacts and warm starts."""
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-m", "tests.envs.gymnasium_x64"]
    environment = {**os.environ, "JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name, result in json.loads(done.stdout.splitlines()[-1]).items():
        assert result["bytes"] == 8
        assert result["observation"] <= 1e-10, (name, result)
        assert result["reward"] <= 1e-10, (name, result)
        assert result["disagreements"] == 0, (name, result)
        assert (result["episodes"] > 0) == (name != "HalfCheetah"), (name, result)


@pytest.mark.parametrize("name", TASKS)
def test_same_model(name, theirs):
    one, two = theirs[name].model, compiled(name).env.model
    for field in dir(two):
        if isinstance(value := getattr(two, field), np.ndarray):
            np.testing.assert_array_equal(value, getattr(one, field), err_msg=field)
    assert compiled(name).env.dt == theirs[name].dt
    spec = gymnasium.spec(f"{name}-v4")
    assert compiled(name).env.max_steps == spec.max_episode_steps == 1000


def test_rewards(theirs):
    """The published formulas, in numbers of this test: v is the root's mean velocity over the step."""
    for name, control, alive in (("HalfCheetah", 0.1, 0.0), ("Hopper", 1e-3, 1.0)):
        case = compiled(name)
        first, actions = case.start(), case.actions()
        after = case.step(first, actions)
        moved = np.asarray(after.data.qpos[:, 0] - first.data.qpos[:, 0], np.float64)
        wanted = (
            moved / theirs[name].dt + alive - control * np.square(np.asarray(actions, np.float64)).sum(axis=1)
        )
        np.testing.assert_allclose(after.reward, wanted, atol=1e-5)
    case = compiled("InvertedPendulum")
    np.testing.assert_array_equal(case.step(case.start(), case.actions()).reward, np.ones(COPIES))


# qpos, qvel changed by hand: [which, index, value]; the bounds are Gymnasium's.
LIMITS = [
    ("InvertedPendulum", "qpos", 1, 0.19, False),
    ("InvertedPendulum", "qpos", 1, 0.21, True),
    ("InvertedPendulum", "qpos", 1, -0.21, True),
    ("Hopper", "qpos", 1, 0.72, False),
    ("Hopper", "qpos", 1, 0.69, True),
    ("Hopper", "qpos", 2, 0.19, False),
    ("Hopper", "qpos", 2, 0.21, True),
    ("Hopper", "qpos", 2, -0.21, True),
    ("Hopper", "qvel", 0, 99.0, False),
    ("Hopper", "qvel", 0, -101.0, True),
    ("HalfCheetah", "qpos", 2, 3.0, False),
]


@pytest.mark.parametrize(("name", "field", "index", "value", "ends"), LIMITS)
def test_terminations(name, field, index, value, ends, theirs):
    task = compiled(name).env.task
    env = theirs[name]
    mujoco.mj_resetData(env.model, env.data)
    getattr(env.data, field)[index] = value
    data = jax.tree.map(lambda x: x[0], compiled(name).start().data)
    data = data.replace(
        qpos=jnp.asarray(env.data.qpos, jnp.float32), qvel=jnp.asarray(env.data.qvel, jnp.float32)
    )
    assert bool(task.terminated(data)) is ends
    assert (
        bool(getattr(env, "terminated", ends)) is ends
    )  # Hopper tells; the pendulum's rule is inside its step


@pytest.mark.parametrize(
    ("name", "scale", "normal"),
    [("InvertedPendulum", 0.01, False), ("Hopper", 5e-3, False), ("HalfCheetah", 0.1, True)],
)
def test_resets(name, scale, normal, theirs):
    """Uniform positions; uniform velocities, normal ones of HalfCheetah."""
    case = compiled(name)
    state = jax.jit(jax.vmap(case.env.reset))(jax.random.split(jax.random.key(5), 4096))
    noise = np.asarray(state.data.qpos) - theirs[name].init_qpos.astype(np.float32)
    assert np.all(np.abs(noise) <= scale * (1 + 1e-4) + 2e-7)
    np.testing.assert_allclose(noise.std(axis=0), scale / np.sqrt(3), rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.05 * scale)
    speed = np.asarray(state.data.qvel)
    np.testing.assert_allclose(speed.std(axis=0), scale if normal else scale / np.sqrt(3), rtol=0.05)
    assert (np.abs(speed).max() > 2 * scale) == normal
    together = np.concatenate([noise, speed], axis=1)
    correlation = np.corrcoef(together, rowvar=False) - np.eye(together.shape[1])
    assert np.abs(correlation).max() < 0.1


@pytest.mark.parametrize("name", TASKS)
def test_observations(name, theirs):
    env = theirs[name]
    env.reset(seed=3)
    env.data.qvel[:] *= 5000.0  # Hopper clips
    data = jax.tree.map(lambda x: x[0], compiled(name).start().data)
    data = data.replace(
        qpos=jnp.asarray(env.data.qpos, jnp.float32), qvel=jnp.asarray(env.data.qvel, jnp.float32)
    )
    np.testing.assert_allclose(compiled(name).env.task.observe(data), env._get_obs(), rtol=1e-6)
    assert envs.make(name).observation_size == env.observation_space.shape[0]
