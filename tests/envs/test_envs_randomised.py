"""Domain randomisation: what is drawn, that an episode keeps its machine, and that it moves as that machine does."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from envs.randomised import RandomisedEnv, Ranges, draw
from tests.envs.compiled import compiled


@pytest.mark.parametrize("name", ["Hopper", "HalfCheetah"])
def test_an_episode_moves_as_its_machine_does(name):
    """Against MuJoCo on the drawn model itself, over ten steps with contacts."""
    plain = compiled(name).env
    env = RandomisedEnv(plain, machines=5)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(3), 6))
    machine = np.asarray(state.info["machine"])
    assert len(set(machine)) > 1
    seeds = np.random.SeedSequence(0).generate_state(5)
    models = [draw(plain.model, Ranges(), int(seeds[k])) for k in machine]
    datas = [mujoco.MjData(model) for model in models]
    for i, data in enumerate(datas):
        data.qpos[:], data.qvel[:] = state.data.qpos[i], state.data.qvel[i]
    step = jax.jit(jax.vmap(env.step))
    for k in range(10):
        actions = np.random.default_rng(k).uniform(-1, 1, (6, env.action_size)).astype(np.float32)
        state = step(state, jnp.asarray(actions))
        for model, data, action in zip(models, datas, actions, strict=True):
            data.ctrl[:] = action
            mujoco.mj_step(model, data, nstep=plain.task.frame_skip)
    for i, data in enumerate(datas):
        np.testing.assert_allclose(state.data.qpos[i], data.qpos, atol=2e-4)
    np.testing.assert_array_equal(state.info["machine"], machine)
    assert len(np.unique(np.asarray(state.obs)[:, 0])) == 6


def test_factors_stay_in_their_ranges_and_fill_them():
    plain = compiled("HalfCheetah").env.model
    ranges = Ranges(mass=(0.5, 2.0), friction=(0.9, 1.1), damping=(1.0, 1.0), gain=(0.8, 1.0))
    models = [draw(plain, ranges, seed) for seed in range(60)]
    masses = np.array([m.body_mass[1:] / plain.body_mass[1:] for m in models])
    assert 0.5 <= masses.min() < 0.6 and 1.9 < masses.max() <= 2.0
    inertias = np.array([m.body_inertia[1:, 1] / plain.body_inertia[1:, 1] for m in models])
    np.testing.assert_allclose(inertias, masses, rtol=1e-9)
    frictions = np.array([m.geom_friction / plain.geom_friction for m in models])
    assert np.ptp(frictions, axis=(1, 2)).max() < 1e-9
    assert 0.9 <= frictions.min() < 0.93 and 1.07 < frictions.max() <= 1.1
    gains = np.array([m.actuator_gainprm[:, 0] / plain.actuator_gainprm[:, 0] for m in models])
    assert 0.8 <= gains.min() < 0.83 and 0.97 < gains.max() <= 1.0
    assert all(np.array_equal(m.dof_damping, plain.dof_damping) for m in models)


def test_the_simulator_itself_is_left_as_it_was():
    plain = envs.make("Hopper", "c")
    before = plain.model.body_mass.copy()
    RandomisedEnv(plain, machines=2)
    np.testing.assert_array_equal(plain.model.body_mass, before)


@pytest.mark.parametrize("ranges", [{"mass": (0.0, 1.0)}, {"gain": (1.2, 0.8)}])
def test_ranges_that_are_none_are_refused(ranges):
    with pytest.raises(ValueError, match="a range of factors needs 0 < low <= high"):
        Ranges(**ranges)
