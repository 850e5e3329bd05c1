"""HalfCheetah's steps with a policy: ours beside raw MuJoCo, Gymnasium's vector environment, and MJX on CPU."""

from functools import partial

import gymnasium
import jax
import jax.numpy as jnp
import mujoco.batch
import numpy as np

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs.c_engine import cores
from experiments.benchmark.clock import stepper
from experiments.benchmark.peers.in_turn import OURS, Call, over
from experiments.benchmark.simulation import SOURCE, of_gymnasium
from mpge_jax.learning import sac
from mpge_jax.learning.sac import SACConfig

RAW, VECTOR, MJX = "raw mujoco.batch, no policy", "Gymnasium vector, no policy", "MJX"


def calls(
    copies: int, steps: int, mjx_steps: int, config: SACConfig
) -> tuple[dict[str, Call], dict[str, float]]:
    """By name, the work of a call and its environment steps.

    Args:
      copies: of HalfCheetah, in each but Gymnasium's, which has 8.
      steps: of each copy in a call. mjx_steps: the same for MJX.
      config: the policy's layers.
    """
    work = {
        OURS: _acting("c", copies, steps, config),
        RAW: _raw(copies, steps),
        VECTOR: _vector(8, steps),
        MJX: _acting("mjx", copies, mjx_steps, config),
    }
    return work, {OURS: copies * steps, RAW: copies * steps, VECTOR: 8 * steps, MJX: copies * mjx_steps}


def _acting(backend: str, copies: int, steps: int, config: SACConfig) -> Call:
    """Episodes with automatic resets, whose actions a stochastic SAC policy draws."""
    env = envs.AutoReset(envs.make(SOURCE, backend))
    scale = jnp.asarray(env.action_high)
    actor = sac.init(jax.random.key(0), env.observation_size, env.action_size, scale, config).actor

    def body(state: envs.State, key: jax.Array) -> tuple[envs.State, None]:
        return jax.vmap(env.step)(state, sac.act(actor, state.obs, key)), None

    @partial(jax.jit, donate_argnums=0)
    def roll(carry: tuple[envs.State, jax.Array]) -> tuple[envs.State, jax.Array]:
        state, key = carry
        key, key_steps = jax.random.split(key)
        return jax.lax.scan(body, state, jax.random.split(key_steps, steps))[0], key

    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), copies))
    return over(stepper(roll, (state, jax.random.key(1))))


def _raw(copies: int, steps: int) -> Call:
    """The engine alone under new uniform commands: no observation, reward, reset or policy."""
    env = envs.make(SOURCE, "c")
    native = mujoco.batch.Batch(env.model, copies, nthread=cores())
    native.reset()
    ctrl = native.bind("ctrl")
    # In turn, so that nothing is drawn while it is timed.
    commands = np.random.default_rng(0).uniform(-1.0, 1.0, (16, *ctrl.shape))

    def call() -> None:
        for step in range(steps):
            ctrl[:] = commands[step % len(commands)]
            native.step(nstep=env.task.frame_skip)

    return call


def _vector(copies: int, steps: int) -> Call:
    """Gymnasium's vector environment, its copies in this process."""
    vector = of_gymnasium(gymnasium.make_vec, copies, "sync")
    vector.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (16, *(vector.action_space.shape or ())))

    def call() -> None:
        for step in range(steps):
            vector.step(actions[step % len(actions)])

    return call
