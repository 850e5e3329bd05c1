"""SAC updates of one agent and of several together."""

import jax
import jax.numpy as jnp

from experiments.benchmark.clock import Row, measure, stepper
from mpge_jax.learning import buffer, sac
from mpge_jax.learning.sac import SACConfig

UPDATES = 64


OBSERVATION, ACTION, ROWS = 17, 6, 10_000
"""HalfCheetah's sizes, and transitions that are drawn for them."""


def full_buffer(key: jax.Array) -> buffer.ReplayBuffer:
    """A buffer full of random transitions."""

    def draw(stream: int, *shape: int) -> jax.Array:
        return jax.random.normal(jax.random.fold_in(key, stream), shape)

    data = buffer.Transition(
        obs=draw(0, ROWS, OBSERVATION),
        action=jnp.tanh(draw(1, ROWS, ACTION)),
        reward=draw(2, ROWS),
        next_obs=draw(3, ROWS, OBSERVATION),
        terminated=jnp.zeros(ROWS),
    )
    return buffer.add_batch(buffer.init(ROWS, OBSERVATION, ACTION), data)


def agent(key: jax.Array, config: SACConfig) -> sac.SACState:
    """An agent of HalfCheetah's sizes."""
    return sac.init(key, OBSERVATION, ACTION, jnp.ones(ACTION), config)


def measure_sac(members: int, config: SACConfig, seconds: float) -> Row:
    """SAC updates a second of `members` agents together, on random transitions of HalfCheetah's sizes."""
    key_init, key_rows = jax.random.split(jax.random.key(0))
    memory = full_buffer(key_rows)
    learners = jax.jit(jax.vmap(lambda k: agent(k, config)))(jax.random.split(key_init, members))

    def one(learner: sac.SACState, key: jax.Array) -> sac.SACState:
        return sac.update_many(learner, memory, key, UPDATES, config)[0]

    @jax.jit
    def step(carry: tuple[sac.SACState, jax.Array]) -> tuple[sac.SACState, jax.Array]:
        learners, key = carry
        key, *each = jax.random.split(key, members + 1)
        return jax.vmap(one)(learners, jnp.stack(each)), key

    row = measure(stepper(step, (learners, jax.random.key(1))), members * UPDATES, seconds)
    return {"members": members, "batch": config.batch_size, **row}
