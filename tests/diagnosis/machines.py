"""Small machines and recordings for the tests of the diagnosis."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from mpge_jax.diagnosis import Recording

PENDULUM = """<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body name="arm">
<joint name="hinge" axis="0 1 0" damping="0.02" armature="0.004"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="hinge" ctrlrange="-2 2" ctrllimited="true"/></actuator></mujoco>"""

FINE_PENDULUM = PENDULUM.replace('timestep="0.005"', 'timestep="0.002"')
"""Where the step itself matters: a search takes as long as there are steps."""

ARM = """<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="0.03" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025" mass=".6" contype="0" conaffinity="0"/>
</body></body></worldbody>
<actuator><motor name="shoulder_motor" joint="shoulder"/><position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>
</actuator></mujoco>"""

FINE_ARM = ARM.replace('timestep="0.005"', 'timestep="0.002"')

BOX = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="5 5 1"/><body name="box" pos="0 0 .1"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="z" type="slide" axis="0 0 1"/><geom name="block" type="box" size=".1 .1 .1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="x"/></actuator></mujoco>"""


FOUR_BAR = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="left"><joint name="crank" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5" contype="0" conaffinity="0"/>
<body name="middle" pos="0 0 -.2"><joint name="rod" axis="0 1 0" damping="0.01"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".4" contype="0" conaffinity="0"/>
<site name="tip" pos=".3 0 0"/></body></body>
<body name="right" pos=".3 0 0"><joint name="rocker" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5" contype="0" conaffinity="0"/>
<site name="end" pos="0 0 -.2"/></body>
<body name="beside" pos="1 0 0"><joint name="alone" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
<equality><connect site1="tip" site2="end" solref=".004 1"/></equality>
<actuator><motor name="crank_motor" joint="crank"/></actuator></mujoco>"""
"""A loop of three joints, and a pendulum that nothing couples to it."""

ROTORS = """<mujoco><worldbody><body name="drone"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="z" type="slide" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
<geom type="box" size=".2 .05 .02" mass="0.8"/><site name="left" pos="-.2 0 0"/><site name="right" pos=".2 0 0"/></body>
</worldbody><actuator><motor name="left" site="left" gear="0 0 1 0 0 0"/>
<motor name="right" site="right" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
"""A planar drone."""


def excitation(kind: int, t: float, phase: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Command [nu] at a time: sums of sines, steps, or a growing chirp."""
    if kind % 3 == 0:
        return size * np.sum([np.sin(2 * np.pi * f * t + phase) for f in (0.6, 1.3, 2.1)], axis=0) / 1.8
    if kind % 3 == 1:
        return size * np.sign(np.sin(2 * np.pi * (0.9 * t) + phase) + 0.4 * np.sin(11.0 * t))
    return size * (0.3 + 0.2 * t) * np.sin(2 * np.pi * (0.3 + 0.4 * t) * t + phase)


def really_sticks(model: mujoco.MjModel, dof: int | slice = slice(None)) -> None:
    """Let dry friction stop joints within a timestep: by its own, MuJoCo's creeps."""
    # at a quarter of the step, as `record` simulates
    damping = -3.6 / model.opt.timestep
    model.dof_solref[dof], model.dof_solimp[dof] = [-1, damping], [0.98, 0.99, 0.001, 0.5, 2]


def record(
    xml: str,
    size: float | list[float],
    change: Callable[[mujoco.MjModel], None] | None = None,
    force: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None,
    count: int = 4,
    seconds: float = 2.0,
    rate: int = 100,
    noise: float = 1e-4,
    seed: int = 0,
) -> list[Recording]:
    """Simulate a machine that differs from `xml`, at four times its rate, and record it with noise."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        model = mujoco.MjModel.from_xml_string(xml)
        if change:
            change(model)
        model.opt.timestep /= 4
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[:] += rng.uniform(-0.3, 0.3, model.nq)
        phase, per = rng.uniform(0, 6, model.nu), round(1 / rate / model.opt.timestep)
        rows: list[tuple[float, np.ndarray, np.ndarray]] = []
        for i in range(int(seconds * rate) + 1):
            u = excitation(k, i / rate, phase, np.broadcast_to(np.asarray(size, float), (model.nu,)))
            rows.append((i / rate, data.qpos.copy(), u))
            for _ in range(per):
                data.ctrl[:] = u
                data.qfrc_applied[:] = 0
                if force:
                    force(model, data)
                mujoco.mj_step(model, data)
        time, qpos, ctrl = (np.array(x) for x in zip(*rows, strict=True))
        qpos = qpos + noise * rng.standard_normal(qpos.shape)
        out.append(Recording(f"run_{k}", time, qpos, None, ctrl))
    return out


def entry(effect: str, at: str, kind: str, **parameters: object) -> dict[str, object]:
    """A row of `effects.json`."""
    return {"id": effect, "at": at, "kind": kind, "parameters": parameters}


FLYER = """<mujoco><option timestep="0.004" gravity="0 0 0"/><worldbody><body name="frame"><freejoint/>
<geom type="box" size=".2 .1 .05" mass="1" contype="0" conaffinity="0"/><site name="s" pos=".2 0 0"/></body></worldbody>
<actuator><motor name="rotor" site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>"""


SERVO = """<mujoco><option timestep="0.002"/><worldbody><body name="arm"><joint name="pivot" axis="0 1 0" damping="1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass="1" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position name="servo" joint="pivot" kp="20"/></actuator></mujoco>"""
