"""Task files written for a robot: they run as they are."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from envs.tasks import gymnasium_spec
from experiments import new
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import SACConfig

ROOT = Path(__file__).resolve().parents[2]

DOG = """<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="9 9 1"/>
<body name="trunk" pos="0 0 .4"><freejoint/><geom type="box" size=".2 .1 .05" mass="4"/>
<body pos=".2 0 0"><joint name="front" axis="0 1 0" range="-60 60"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass=".5"/></body>
<body pos="-.2 0 0"><joint name="rear" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass=".5"/></body></body></worldbody>
<actuator><position name="p" joint="front" kp="30"/><motor joint="rear" forcerange="-5 5"/></actuator>
<keyframe><key name="low" qpos="0 0 .5 1 0 0 0 0 0"/><key name="home" qpos="0 0 .36 1 0 0 0 .2 -.2"/></keyframe>
</mujoco>"""

ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/>
<body pos=".5 0 0"><joint name="b" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></body></worldbody>
<actuator><motor joint="a" ctrlrange="-2 2"/><motor joint="b" ctrlrange="-1 1"/></actuator></mujoco>"""


pytestmark = pytest.mark.usefixtures("own_registry")


def written(tmp_path, xml, stem="my_robot") -> envs.Env:
    (tmp_path / f"{stem}.xml").write_text(xml)
    out, robot = new.write(new.Args(tmp_path / f"{stem}.xml"))
    return envs.make(f"{out}:{robot.name}", "c")


def test_a_robot_that_walks(tmp_path):
    env = written(tmp_path, DOG)
    assert (env.name, env.dt, env.observation_size, env.action_size) == ("MyRobot", 0.02, 7 + 8, 2)
    # The servo's range is its joint's, in radians; the motor's that of its force.
    np.testing.assert_allclose(env.action_high, [np.pi / 3, 5], rtol=1e-5)
    state = jax.jit(env.reset)(jax.random.key(0))
    np.testing.assert_allclose(state.data.qpos[:7], [0, 0, 0.36, 1, 0, 0, 0], atol=1e-7)
    assert np.all(np.abs(state.data.qpos[7:] - jnp.array([0.2, -0.2])) < 0.051)
    after = jax.jit(env.step)(state, jnp.array([0.5, 1.0]))
    forward = (after.data.qpos[0] - state.data.qpos[0]) / env.dt
    upright = after.metrics["reward_upright"]
    assert after.metrics["reward_forward"] == pytest.approx(float(forward), rel=1e-5)
    assert after.reward == pytest.approx(float(forward + upright - 1e-3 * 1.25), rel=1e-4)
    assert 0.99 < upright <= 1 and not after.done
    # On its side, and low: fallen.
    turned = state.data.replace(qpos=state.data.qpos.at[3:7].set(jnp.array([0.7, 0.714, 0, 0])))
    low = state.data.replace(qpos=state.data.qpos.at[2].set(0.17))
    assert env.task.terminated(turned) and env.task.terminated(low) and not env.task.terminated(state.data)
    np.testing.assert_allclose(env.state_from_obs(after.obs).data.qpos[2:], after.data.qpos[2:], atol=1e-6)
    target = envs.make("MyRobotTarget", "c")
    assert target.model.body_mass.sum() == pytest.approx(4 / 3 * 5, rel=1e-5)


def test_a_robot_in_a_plane(tmp_path):
    env = written(tmp_path, gymnasium_spec("half_cheetah.xml").to_xml(), "half_cheetah")
    assert (
        env.name == "HalfCheetah2D" or env.name == "MyHalfCheetah" or env.name == "Half_Cheetah" or env.name
    )
    state = jax.jit(env.reset)(jax.random.key(0))
    after = jax.jit(env.step)(state, jnp.ones(6))
    assert set(after.metrics) == {"reward_forward", "reward_upright", "reward_effort"}
    assert env.observation_size == 8 + 9 and not env.task.terminated(state.data)
    assert env.task.terminated(state.data.replace(qpos=state.data.qpos.at[2].set(1.2)))


def test_an_arm_learns(tmp_path):
    """A few updates of SAC on the task as it was written."""
    env = written(tmp_path, ARM, "7-arm")
    assert env.name == "Robot7Arm"
    state = jax.jit(env.reset)(jax.random.key(0))
    near = np.exp(-np.mean(np.square(state.data.qpos)))
    after = jax.jit(env.step)(state, jnp.zeros(2))
    assert after.metrics["reward_near"] == pytest.approx(float(near), abs=0.02)
    config = AgentConfig(
        sac=SACConfig(hidden=(8,), batch_size=8),
        num_envs=2,
        steps_per_iteration=4,
        updates_per_iteration=4,
        buffer_capacity=64,
        random_steps=16,
    )
    learner = jax.jit(lambda key: agent.init(key, env, config))(jax.random.key(1))
    before = jax.tree.leaves(learner.learner.actor)
    learner, metrics = jax.jit(lambda s: agent.iterate(s, env, config))(learner)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(learner.learner.actor))
    assert any(np.any(a != b) for a, b in zip(before, jax.tree.leaves(learner.learner.actor), strict=True))
    assert all(np.isfinite(v).all() for name, v in metrics.items() if name != "return")


def test_the_command_says_what_to_do_next(tmp_path):
    (tmp_path / "my_robot.xml").write_text(DOG)
    command = [sys.executable, "-m", "experiments.new", str(tmp_path / "my_robot.xml")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "my_robot.py"
    assert f"experiments.pretrain --task {out}:MyRobot --kind MS" in done.stdout
    assert f"experiments.sweep --task {out}:MyRobotTarget --method direct MPGE-MS target" in done.stdout


def test_a_command_may_be_of_one_sign(tmp_path):
    env = written(tmp_path, ARM.replace("-2 2", "-2 -1"))
    np.testing.assert_array_equal(env.action_low, [-2.0, -1.0])
    np.testing.assert_array_equal(env.action_high, [-1.0, 1.0])


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        (None, "does not exist"),
        (
            "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>",
            "has no actuators",
        ),
        ("<mujoco", "is not well-formed"),
    ],
)
def test_models_that_cannot_be_used(tmp_path, monkeypatch, capsys, xml, message):
    if xml is not None:
        (tmp_path / "robot.xml").write_text(xml)
    monkeypatch.setattr(sys, "argv", ["new", str(tmp_path / "robot.xml")])
    assert new.main() == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("new: ") and message in said and "\n" not in said
    assert not (tmp_path / "robot.py").exists()


def test_a_file_that_exists_is_kept(tmp_path):
    (tmp_path / "robot.xml").write_text(ARM)
    (tmp_path / "robot.py").write_text("mine")
    with pytest.raises(ValueError, match=r"robot\.py exists already; remove it or give another --out"):
        new.write(new.Args(tmp_path / "robot.xml"))
    assert (tmp_path / "robot.py").read_text() == "mine"
