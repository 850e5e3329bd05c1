"""The paper's three source tasks, as Gymnasium's v2-v4 define them, on Gymnasium's own model files."""

import importlib.resources
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from envs.types import Task


def gymnasium_spec(filename: str) -> mujoco.MjSpec:
    """A model file of the installed gymnasium, without the deprecated `settotalmass` (see `Task.total_mass`)."""
    path = importlib.resources.files("gymnasium") / "envs" / "mujoco" / "assets" / filename
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.settotalmass = -1.0
    return spec


def _uniform(key: jax.Array, size: int, scale: float) -> jax.Array:
    return jax.random.uniform(key, (size,), minval=-scale, maxval=scale)


def _cheetah_reset(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    key_qpos, key_qvel = jax.random.split(key)
    return _uniform(key_qpos, 9, 0.1), 0.1 * jax.random.normal(key_qvel, (9,))


def _without_root_x(data: Any) -> jax.Array:
    return jnp.concatenate([data.qpos[1:], data.qvel])


def _cheetah_reward(
    data: Any, action: jax.Array, after: Any, dt: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    run = (after.qpos[0] - data.qpos[0]) / dt
    control = -0.1 * jnp.sum(jnp.square(action))
    return run + control, {"reward_run": run, "reward_control": control}


def _never(data: Any) -> jax.Array:
    del data
    return jnp.zeros((), bool)


def _cheetah_to_state(obs: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jnp.concatenate([jnp.zeros(1, obs.dtype), obs[:8]]), obs[8:]


def _hopper_reset(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    key_qpos, key_qvel = jax.random.split(key)
    # The root's height rests at its reference, 1.25 m.
    rest = jnp.zeros(6).at[1].set(1.25)
    return rest + _uniform(key_qpos, 6, 5e-3), _uniform(key_qvel, 6, 5e-3)


def _hopper_observe(data: Any) -> jax.Array:
    return jnp.concatenate([data.qpos[1:], jnp.clip(data.qvel, -10.0, 10.0)])


def _hopper_reward(
    data: Any, action: jax.Array, after: Any, dt: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    run = (after.qpos[0] - data.qpos[0]) / dt
    control = -1e-3 * jnp.sum(jnp.square(action))
    return run + 1.0 + control, {"reward_run": run, "reward_control": control}


def _hopper_terminated(data: Any) -> jax.Array:
    rest = jnp.concatenate([data.qpos[2:], data.qvel])
    healthy = jnp.all(jnp.abs(rest) < 100.0) & (data.qpos[1] > 0.7) & (jnp.abs(data.qpos[2]) < 0.2)
    return ~healthy


def _hopper_to_state(obs: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jnp.concatenate([jnp.zeros(1, obs.dtype), obs[:5]]), obs[5:]


def _pendulum_reset(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    key_qpos, key_qvel = jax.random.split(key)
    return _uniform(key_qpos, 2, 0.01), _uniform(key_qvel, 2, 0.01)


def _pendulum_observe(data: Any) -> jax.Array:
    return jnp.concatenate([data.qpos, data.qvel])


def _pendulum_reward(
    data: Any, action: jax.Array, after: Any, dt: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    del data, action, dt
    return jnp.ones((), after.qpos.dtype), {}


def _pendulum_terminated(data: Any) -> jax.Array:
    finite = jnp.all(jnp.isfinite(data.qpos)) & jnp.all(jnp.isfinite(data.qvel))
    return ~finite | (jnp.abs(data.qpos[1]) > 0.2)


def _pendulum_to_state(obs: jax.Array) -> tuple[jax.Array, jax.Array]:
    return obs[:2], obs[2:]


TASKS = (
    Task(
        name="InvertedPendulum",
        spec=lambda: gymnasium_spec("inverted_pendulum.xml"),
        frame_skip=2,
        reset=_pendulum_reset,
        observe=_pendulum_observe,
        reward=_pendulum_reward,
        terminated=_pendulum_terminated,
        to_state=_pendulum_to_state,
    ),
    Task(
        name="Hopper",
        spec=lambda: gymnasium_spec("hopper.xml"),
        frame_skip=4,
        reset=_hopper_reset,
        observe=_hopper_observe,
        reward=_hopper_reward,
        terminated=_hopper_terminated,
        to_state=_hopper_to_state,
    ),
    Task(
        name="HalfCheetah",
        spec=lambda: gymnasium_spec("half_cheetah.xml"),
        frame_skip=5,
        reset=_cheetah_reset,
        observe=_without_root_x,
        reward=_cheetah_reward,
        terminated=_never,
        to_state=_cheetah_to_state,
        total_mass=14.0,
    ),
)
