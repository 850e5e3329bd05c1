"""Targets against hand-edited models, the old capsule inertia, and what a user adds."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, NAMES, compiled


def assert_close(one, two):
    np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-6)


def test_names():
    assert envs.names()[:7] == [
        *("InvertedPendulum", "Hopper", "HalfCheetah"),
        *("SkewedPendulum", "BrokenHopper", "BrokenCheetah", "HeavyCheetah"),
    ]
    assert [envs.source_of(name) for name in envs.names()[3:7]] == [
        *("InvertedPendulum", "Hopper", "HalfCheetah", "HalfCheetah")
    ]
    assert envs.source_of("Hopper") == "Hopper"


@pytest.mark.parametrize("name", NAMES[3:])
def test_a_target_differs_from_its_source(name):
    """Not always in its first steps: a slope has to be reached, a contact made."""
    target, source = compiled(name), compiled(envs.source_of(name))
    moved, reference = target.start(), source.start()
    np.testing.assert_array_equal(moved.obs, reference.obs)
    for k in range(12):
        moved, reference = (
            case.step(state, source.actions(k)) for case, state in ((target, moved), (source, reference))
        )
    assert np.all(np.abs(moved.obs - reference.obs).max(axis=1) > 1e-4)


def test_skewed_pendulum():
    target, source = compiled("SkewedPendulum"), compiled("InvertedPendulum")
    first = source.start()
    actions = jnp.array([[-2.0], [0.0], [1.4], [2.5]])
    executed = jnp.array([[-0.5], [1.5], [2.9], [3.0]])
    np.testing.assert_array_equal(target.step(first, actions).obs, source.step(first, executed).obs)


@pytest.mark.parametrize(("name", "cost"), [("BrokenHopper", 1e-3), ("BrokenCheetah", 0.1)])
def test_broken(name, cost):
    """Actuator 0 is dead, and its command is not charged."""
    target, source = compiled(name), compiled(envs.source_of(name))
    first, actions = source.start(), source.actions()
    after = target.step(first, actions)
    by_hand = source.step(first, actions.at[:, 0].set(0.0))
    np.testing.assert_array_equal(after.obs, by_hand.obs)
    assert_close(after.reward, by_hand.reward)
    assert_close(after.metrics["reward_control"], -cost * jnp.square(actions[:, 1:]).sum(axis=1))


@pytest.mark.parametrize("name", ["BrokenHopper", "BrokenCheetah"])
def test_charged(name):
    """`charged` changes what is paid and nothing else."""
    case = compiled(name)
    first, actions = case.start(), case.actions()
    paid = case.actions(7)
    plain = case.step(first, actions)
    charged = jax.jit(jax.vmap(lambda s, a, c: case.env.step(s, a, charged=c)))(first, actions, paid)
    np.testing.assert_array_equal(charged.obs, plain.obs)
    cost = 1e-3 if name == "BrokenHopper" else 0.1
    assert_close(charged.metrics["reward_control"], -cost * jnp.square(paid).sum(axis=1))
    assert_close(charged.metrics["reward_run"], plain.metrics["reward_run"])
    change = charged.metrics["reward_control"] - plain.metrics["reward_control"]
    np.testing.assert_allclose(charged.reward - plain.reward, change, atol=1e-5)


def test_heavy_cheetah():
    light, heavy = compiled("HalfCheetah").env.model, compiled("HeavyCheetah").env.model
    assert light.body_mass.sum() == pytest.approx(14.0, rel=1e-12)
    np.testing.assert_allclose(heavy.body_mass, light.body_mass * 20 / 14, rtol=1e-12)
    np.testing.assert_allclose(heavy.body_inertia, light.body_inertia * 20 / 14, rtol=1e-12)
    edited = compiled("HalfCheetah").env.model.__copy__()
    edited.body_mass[:] *= 20 / 14
    edited.body_inertia[:] *= 20 / 14
    mujoco.mj_setConst(edited, mujoco.MjData(edited))
    np.testing.assert_allclose(heavy.dof_invweight0, edited.dof_invweight0, rtol=1e-9)
    case = compiled("HeavyCheetah")
    first, actions = case.start(), case.actions()
    after = case.step(first, actions)
    for i in range(COPIES):
        data = mujoco.MjData(edited)
        data.qpos[:], data.qvel[:], data.ctrl[:] = first.data.qpos[i], first.data.qvel[i], actions[i]
        mujoco.mj_step(edited, data, nstep=5)
        assert_close(after.data.qpos[i], data.qpos)
        assert_close(after.data.qvel[i], data.qvel)


CAPSULE = """
<mujoco>
  <default><geom material="steel" mass="7"/></default>
  <asset><material name="steel" rgba=".5 .5 .5 1"/></asset>
  <worldbody>
    <body name="b">
      <joint name="j" axis="0 1 0"/>
      <geom type="capsule" size="0.1 0.3" pos="0.2 0 0" {weight}/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(("weight", "given"), [('mass="2"', 2.0), ("", 7.0)])
def test_legacy_inertia(weight, given):
    """A solid cylinder of radius 0.1 and length 2 (0.3 + 0.05): m r^2 / 2 and m (3 r^2 + l^2) / 12."""
    spec = mujoco.MjSpec.from_string(CAPSULE.format(weight=weight))
    envs.legacy.use_legacy_inertia(spec)
    model = spec.compile()
    across = given * (3 * 0.1**2 + 0.7**2) / 12
    assert model.body_mass[1] == pytest.approx(given)
    np.testing.assert_allclose(sorted(model.body_inertia[1]), [given * 0.1**2 / 2, across, across])
    np.testing.assert_allclose(model.body_ipos[1], [0.2, 0, 0])
    # Neither touched, nor met by rays, nor drawn.
    twin = model.ngeom - 1
    assert model.geom_contype[twin] == model.geom_conaffinity[twin] == 0
    assert model.geom_rgba[twin, 3] == 0 and model.geom_matid[twin] == -1


def test_legacy_density():
    """Where density gives the mass, the longer cylinder is also heavier: pi r^2 (2 h + r), the capsule 4/3 r for r."""
    for name in ("InvertedPendulum", "Hopper"):
        new, old = compiled(name).env.model, envs.make(name, dynamics="legacy").model
        capsules = [i for i in range(new.ngeom) if new.geom_type[i] == mujoco.mjtGeom.mjGEOM_CAPSULE]
        for body in range(1, new.nbody):
            mass = sum(
                1000 * np.pi * r**2 * (2 * h + r)
                for r, h, _ in new.geom_size[[i for i in capsules if new.geom_bodyid[i] == body]]
            )
            assert old.body_mass[body] == pytest.approx(mass, rel=1e-9)
    cheetah = envs.make("HalfCheetah", dynamics="legacy").model
    assert cheetah.body_mass.sum() == pytest.approx(14.0, rel=1e-12)
    assert envs.make("HeavyCheetah", dynamics="legacy").model.body_mass.sum() == pytest.approx(
        20.0, rel=1e-12
    )
    assert np.abs(cheetah.body_inertia - compiled("HalfCheetah").env.model.body_inertia).max() > 1e-3


SLIDER = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="block">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" mass="2"/>
    </body>
  </worldbody>
  <actuator><motor joint="x" {limits}/></actuator>
</mujoco>
"""


def slider(**changes):
    """A block on a rail, pushed by at most 1 N: what a user writes for a robot of their own."""
    fields = {
        "name": "Slider",
        "spec": lambda: mujoco.MjSpec.from_string(SLIDER.format(limits='ctrlrange="-1 1"')),
        "frame_skip": 2,
        "reset": lambda key: (jax.random.uniform(key, (1,)), jnp.zeros(1)),
        "observe": lambda data: jnp.concatenate([data.qpos, data.qvel]),
        "reward": lambda data, action, after, dt: (after.qpos[0], {}),
        "terminated": lambda data: data.qpos[0] > 5.0,
        "max_steps": 3,
    }
    return envs.Task(**{**fields, **changes})


def weaken(spec):
    spec.body("block").geoms[0].mass = 4.0


def test_a_task_and_a_variant_of_ones_own(own_registry):
    envs.register(slider())
    envs.register(envs.Variant("HeavySlider", "Slider", "twice the mass", spec=weaken))
    envs.register(
        envs.Variant("LimpSlider", "Slider", "half the force", action=lambda action, low, high: action / 2)
    )
    assert envs.names()[3] == "Slider"  # tasks come first
    assert envs.source_of("LimpSlider") == "Slider"
    speeds = {}
    for name in ("Slider", "HeavySlider", "LimpSlider"):
        env = envs.make(name)
        assert (env.observation_size, env.action_size, env.max_steps, env.dt) == (2, 1, 3, 0.02)
        state = env.reset(jax.random.key(0))
        state = jax.jit(env.step)(state, jnp.ones(1))
        speeds[name] = float(state.obs[1])
    # Two steps of 0.01 s at 1 N / 2 kg.
    assert speeds["Slider"] == pytest.approx(0.01, rel=1e-6)
    assert speeds["HeavySlider"] == speeds["LimpSlider"] == pytest.approx(0.005, rel=1e-6)


def test_the_time_limit_is_the_tasks(own_registry):
    envs.register(slider())
    env = envs.make("Slider")
    state, step = env.reset(jax.random.key(0)), jax.jit(env.step)
    ends = []
    for _ in range(3):
        state = step(state, jnp.zeros(1))
        ends.append((float(state.info["terminated"]), float(state.info["truncated"]), float(state.done)))
    assert ends == [(0, 0, 0), (0, 0, 0), (0, 1, 1)]


def test_names_are_taken_once(own_registry):
    envs.register(slider())
    with pytest.raises(ValueError, match="an environment named 'Slider' is registered already"):
        envs.register(slider())
    with pytest.raises(ValueError, match="unknown task 'Slidr'; did you mean 'Slider'"):
        envs.register(envs.Variant("Other", "Slidr", "of nothing"))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"reset": lambda key: (jnp.zeros(2), jnp.zeros(1))},
            r"Slider: reset's qpos has shape \(2,\) where \(1,\) is",
        ),
        ({"observe": lambda data: data.qpos[0]}, r"Slider: observe has shape \(\) where \(1,\) is wanted"),
        (
            {"reward": lambda data, action, after, dt: (after.qpos, {})},
            r"Slider: reward has shape \(1,\) where \(\)",
        ),
        (
            {"terminated": lambda data: data.qpos > 5.0},
            r"Slider: terminated has shape \(1,\) where \(\) is wanted",
        ),
        (
            {"spec": lambda: mujoco.MjSpec.from_string(SLIDER.format(limits=""))},
            r"ctrlrange.*actuator 0 has none",
        ),
    ],
)
def test_mistakes_in_a_task_are_told(changes, sentence, own_registry):
    envs.register(slider(**changes))
    with pytest.raises(ValueError, match=sentence):
        envs.make("Slider")


def test_mistakes_in_numbers_are_told():
    with pytest.raises(ValueError, match="frame_skip and max_steps must be at least 1, got 0 and 3"):
        slider(frame_skip=0)
    with pytest.raises(ValueError, match=r"Other: total_mass must be above 0 kg, got -1"):
        envs.Variant("Other", "Hopper", "impossible", total_mass=-1)


def test_a_task_without_to_state(own_registry):
    envs.register(slider())
    with pytest.raises(ValueError, match="Slider has no to_state"):
        envs.make("Slider").state_from_obs(jnp.zeros(2))
