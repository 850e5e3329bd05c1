"""A simulated arm that holds up its hand, and a target of it in which something is concealed."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from envs import Env, Task, Variant, build_model, engine_of
from mpge_jax.diagnosis import Recording

XML = """<mujoco model="arm">
<compiler angle="radian"/><option timestep="0.005" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default>
<worldbody>
<geom type="cylinder" fromto="0 -.06 0 0 .06 0" size=".06" rgba=".5 .5 .5 1"/>
<body name="upper_arm"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.35" size=".035" mass="1.2"/>
<body name="forearm" pos="0 0 -.35"><joint name="elbow" axis="0 1 0" damping="0.15" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".028" mass=".7"/>
<site name="hand" pos="0 0 -.3"/></body></body></worldbody>
<actuator><motor name="shoulder_motor" joint="shoulder" ctrlrange="-12 12"/>
<motor name="elbow_motor" joint="elbow" ctrlrange="-5 5"/></actuator></mujoco>"""
UPPER, FORE = 0.35, 0.3
"""Lengths of the links, m."""
GOAL = (0.5, 0.05)
"""Where the hand is to be held, m in front of and above the shoulder."""
NEAR = 0.03
"""Distance from the goal at which the reward of a step is one half, m."""
BENT = 0.3
"""Angle to which the spring pulls the elbow, rad."""
FRAME_SKIP, MAX_STEPS = 8, 100


def _reset(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.random.uniform(key, (2,), minval=-0.5, maxval=0.5), jnp.zeros(2)


def _observe(data: Any) -> jax.Array:
    return jnp.concatenate([jnp.sin(data.qpos), jnp.cos(data.qpos), 0.2 * data.qvel])


def _distance(qpos: jax.Array) -> jax.Array:
    upper, both = qpos[0], qpos[0] + qpos[1]
    ahead = -UPPER * jnp.sin(upper) - FORE * jnp.sin(both)
    above = -UPPER * jnp.cos(upper) - FORE * jnp.cos(both)
    return jnp.hypot(ahead - GOAL[0], above - GOAL[1])


def _reward(data: Any, action: jax.Array, after: Any, dt: float) -> tuple[jax.Array, dict[str, jax.Array]]:
    del data, action, dt
    distance = _distance(after.qpos)
    return 1.0 / (1.0 + jnp.square(distance / NEAR)), {"distance": distance}


def _terminated(data: Any) -> jax.Array:
    return jnp.any(jnp.abs(data.qvel) > 100.0)


TASK = Task(
    name="DemoArm",
    spec=lambda: mujoco.MjSpec.from_string(XML),
    frame_skip=FRAME_SKIP,
    reset=_reset,
    observe=_observe,
    reward=_reward,
    terminated=_terminated,
    max_steps=MAX_STEPS,
)


@dataclass(frozen=True)
class Concealed:
    """What the target has and the simulator lacks.

    Attributes:
        id, at: as in the vocabulary of the diagnosis. parameter, value, unit: its size.
        about: in words.
    """

    id: str
    at: str
    parameter: str
    value: float
    unit: str
    about: str

    def put_into(self, spec: mujoco.MjSpec) -> None:
        """Change a description of the arm in place."""
        if self.id == "payload_mass":
            load = spec.body(self.at).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.04, 0, 0], pos=[0, 0, -FORE]
            )
            load.mass = self.value
        elif self.id == "joint_stiffness":
            spec.joint(self.at).stiffness = [self.value, 0.0, 0.0]
            spec.joint(self.at).springref = BENT
        else:
            gain = np.array(spec.actuator(self.at).gainprm)
            gain[0] *= self.value
            spec.actuator(self.at).gainprm = gain


def concealed(seed: int) -> Concealed:
    """Draws what is concealed: a load, a spring or a weak motor, and its size."""
    rng = np.random.default_rng(seed)
    kind, size = rng.integers(3), rng.uniform(0.0, 1.0)
    if kind == 0:
        mass = round(0.7 + 0.3 * size, 2)
        return Concealed("payload_mass", "forearm", "mass", mass, "kg", "a load in the hand")
    if kind == 1:
        gain = round(0.45 + 0.1 * size, 2)
        return Concealed("actuator_gain", "shoulder_motor", "gain", gain, "1", "a weak motor at the shoulder")
    pull = round(1.5 + 0.6 * size, 2)
    return Concealed(
        "joint_stiffness", "elbow", "stiffness", pull, "N m/rad", "a spring that holds the elbow bent"
    )


def simulator() -> Env:
    """The arm as it is thought to be."""
    model = build_model(TASK)
    return Env(TASK, model, engine_of(model))


def target(hidden: Concealed) -> Env:
    """The arm as it is."""
    variant = Variant("DemoArmTarget", TASK.name, hidden.about, spec=hidden.put_into)
    model = build_model(TASK, variant)
    return Env(TASK, model, engine_of(model), variant)


def recordings(hidden: Concealed, seed: int) -> list[Recording]:
    """Six recordings of 4 s at 100 Hz, the last two held out: both motors driven by sums of sines, angles measured with
    a noise of 1 mrad."""
    model, rng = target(hidden).model, np.random.default_rng((seed, 1))
    return [_recording(model, rng, f"heldout_{k}" if k > 3 else f"run_{k}") for k in range(6)]


def _recording(model: mujoco.MjModel, rng: np.random.Generator, name: str) -> Recording:
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-0.5, 0.5, 2)
    time = np.arange(401) / 100
    frequency = rng.uniform([[0.2], [0.5], [1.0]], [[0.5], [1.0], [2.0]], (3, 2))
    phase, share = rng.uniform(0, 2 * np.pi, (3, 2)), np.array([[0.5], [0.3], [0.2]])
    command = np.array([5.0, 1.5]) * (
        share * np.sin(2 * np.pi * frequency * time[:, None, None] + phase)
    ).sum(1)
    qpos = np.zeros((time.size, 2))
    for row, u in enumerate(command):
        qpos[row] = data.qpos
        data.ctrl[:] = u
        mujoco.mj_step(model, data, round(0.01 / model.opt.timestep))
    return Recording(name, time, qpos + 1e-3 * rng.standard_normal(qpos.shape), None, command)
