"""A task in a corrected machine, whose effects the engine computes with."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from mpge_jax.diagnosis.corrected.tasks import corrected_env, nominal_spec
from mpge_jax.grounding import prediction
from tests.diagnosis.machines import entry

DRAG = entry("quadratic_drag", "pole", "body", coefficient=0.5)
OFF = entry("encoder_offset", "hinge", "joint", offset=0.1)


@pytest.mark.parametrize("effects", [[DRAG], [OFF]], ids=["drag", "offset"])
def test_states_are_told_as_in_the_task_itself(effects):
    env = corrected_env(nominal_spec("InvertedPendulum"), effects, "InvertedPendulum", "c")
    assert isinstance(env, envs.Env) and env.observed.all()
    obs = jnp.array([[0.1, 0.05, 0.3, -2.0], [0.0, 0.0, 0.0, 0.0]])
    assert np.asarray(jax.jit(jax.vmap(env.tells_state))(obs)).all()
    rows = prediction.HeldOut(obs, jnp.zeros((2, 1)), obs + jnp.array([[0.1], [-0.1]]), jnp.ones(2))
    error = jax.jit(lambda rows: prediction.error_under(env, rows, rows.action))(rows)
    assert np.isfinite(error)
