"""SAC updates of one agent and of several together."""

import jax
import jax.numpy as jnp

from experiments.benchmark.clock import Row, measure, stepper
from mpge_jax.learning import buffer, sac
from mpge_jax.learning.sac import SACConfig

UPDATES = 64


def measure_sac(members: int, config: SACConfig, seconds: float) -> Row:
    """SAC updates a second of `members` agents together, on random transitions of HalfCheetah's sizes."""
    obs_size, action_size, rows = 17, 6, 10_000
    key_init, key_rows = jax.random.split(jax.random.key(0))

    def draw(stream: int, *shape: int) -> jax.Array:
        return jax.random.normal(jax.random.fold_in(key_rows, stream), shape)

    data = buffer.Transition(
        obs=draw(0, rows, obs_size),
        action=jnp.tanh(draw(1, rows, action_size)),
        reward=draw(2, rows),
        next_obs=draw(3, rows, obs_size),
        terminated=jnp.zeros(rows),
    )
    memory = buffer.add_batch(buffer.init(rows, obs_size, action_size), data)
    learners = jax.jit(jax.vmap(lambda k: sac.init(k, obs_size, action_size, jnp.ones(action_size), config)))(
        jax.random.split(key_init, members)
    )

    def one(learner: sac.SACState, key: jax.Array) -> sac.SACState:
        return sac.update_many(learner, memory, key, UPDATES, config)[0]

    @jax.jit
    def step(carry: tuple[sac.SACState, jax.Array]) -> tuple[sac.SACState, jax.Array]:
        learners, key = carry
        key, *each = jax.random.split(key, members + 1)
        return jax.vmap(one)(learners, jnp.stack(each)), key

    row = measure(stepper(step, (learners, jax.random.key(1))), members * UPDATES, seconds)
    return {"members": members, "batch": config.batch_size, **row}
