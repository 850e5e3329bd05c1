"""Targets with hidden physics: late commands by hand, and the fields of the models."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from envs.variants import HIDDEN, PAPER
from tests.envs.compiled import compiled


@pytest.mark.parametrize(("name", "delay"), [("LatePendulum", 1), ("LateCheetah", 2)])
def test_late_commands_by_hand(name, delay):
    """The command of the step before, none at first, is held for `delay` physics steps."""
    case = compiled(name)
    env, first = case.env, case.start()
    skip = env.task.frame_skip
    one, two = case.actions(1), case.actions(2)
    state = case.step(case.step(first, one), two)
    data = mujoco.MjData(env.model)
    for i in range(len(one)):
        mujoco.mj_resetData(env.model, data)
        data.qpos[:], data.qvel[:] = first.data.qpos[i], first.data.qvel[i]
        for command, count in ((np.zeros(one.shape[1]), delay), (one[i], skip), (two[i], skip - delay)):
            data.ctrl[:] = command
            mujoco.mj_step(env.model, data, nstep=count)
        np.testing.assert_allclose(state.data.qpos[i], data.qpos, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(state.info["command"], two)


def test_a_new_episode_begins_without_a_command():
    env = envs.AutoReset(compiled("LatePendulum").env)
    state, step = env.reset(jax.random.key(0)), jax.jit(env.step)
    for _ in range(60):
        state = step(state, jnp.array([3.0]))
        held = float(state.info["command"][0])
        assert held == (0.0 if state.done else 3.0)
        if state.done:
            return
    raise AssertionError("the pole did not fall")


def test_a_delay_of_a_whole_step_and_of_more(own_registry):
    envs.register(envs.Variant("Later", "InvertedPendulum", "a whole step late", delay=2))
    later, plain = envs.make("Later", "c"), compiled("InvertedPendulum").env
    state = later.step(later.reset(jax.random.key(0)), jnp.array([2.0]))
    wanted = plain.step(plain.reset(jax.random.key(0)), jnp.array([0.0]))
    np.testing.assert_array_equal(state.obs, wanted.obs)
    envs.register(envs.Variant("TooLate", "InvertedPendulum", "more than a step late", delay=3))
    with pytest.raises(ValueError, match="TooLate: a delay of 3 physics steps is longer than one step"):
        envs.make("TooLate", "c")
    with pytest.raises(ValueError, match="delay must be at least 0 physics steps, got -1"):
        envs.Variant("Early", "Hopper", "impossible", delay=-1)


def test_the_fields_that_are_hidden():
    dof = {"StickyPendulum": ("slider", 150.0), "StickyCheetah": ("fthigh", 60.0)}
    for name, (joint, level) in dof.items():
        model = compiled(name).env.model
        wanted = np.zeros(model.nv)
        wanted[model.joint(joint).dofadr[0]] = level
        np.testing.assert_array_equal(model.dof_frictionloss, wanted)
    loaded, hopper = compiled("LoadedHopper").env.model, compiled("Hopper").env.model
    assert loaded.body_mass.sum() - hopper.body_mass.sum() == pytest.approx(1.5)
    torso = loaded.body("torso").id
    # The centre of mass of 3.67 kg at 0 and of 1.5 kg at (-0.06, 0, 0.1).
    share = 1.5 / (1.5 + hopper.body_mass[torso])
    np.testing.assert_allclose(loaded.body_ipos[torso], [-0.06 * share, 0.0, 0.1 * share], atol=1e-9)
    assert np.all(compiled("SlipperyCheetah").env.model.geom_friction[:, 0] == 0.05)


def test_a_strap_pulls_both_hips_to_opposite_angles():
    model = compiled("StrappedCheetah").env.model
    data = mujoco.MjData(model)
    hips = [int(model.joint(name).qposadr[0]) for name in ("bthigh", "fthigh")]
    for back, front in ((0.3, -0.3), (0.3, 0.2)):
        data.qpos[hips] = back, front
        mujoco.mj_forward(model, data)
        bare = mujoco.MjData(compiled("HalfCheetah").env.model)
        bare.qpos[hips] = back, front
        mujoco.mj_forward(compiled("HalfCheetah").env.model, bare)
        pull = (data.qfrc_passive - bare.qfrc_passive)[hips]
        np.testing.assert_allclose(pull, [-90.0 * (back + front)] * 2, atol=1e-6)


def test_the_page_of_targets_has_them_all():
    page = (Path(__file__).parents[2] / "docs" / "targets.md").read_text("utf-8")
    for variant in (*PAPER, *HIDDEN):
        assert f"| `{variant.name}` | {variant.task} | {variant.about} |" in page
