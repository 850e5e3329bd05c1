"""An arm as they are built: friction and rotor inertia in each of six joints behind servos, and a payload."""

import os

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose

LINKS = """<mujoco><option timestep="0.002" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default>
<worldbody><body name="l1" pos="0 0 .25"><joint name="j1" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 .12" size=".05" mass="2.5"/>
<body name="l2" pos="0 0 .12"><joint name="j2" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .35 0 0" size=".045" mass="3.5"/>
<body name="l3" pos=".35 0 0"><joint name="j3" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".035" mass="2"/>
<body name="l4" pos=".3 0 0"><joint name="j4" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .08 .03 0" size=".03" mass="1"/>
<body name="l5" pos=".08 0 0"><joint name="j5" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 .08 0 .03" size=".03" mass="1"/>
<body name="l6" pos=".08 0 0"><joint name="j6" axis="1 0 0"/>
<geom type="box" pos=".03 .01 .01" size=".03 .04 .02" mass=".4"/>
</body></body></body></body></body></body></worldbody><actuator>
<position name="a1" joint="j1" kp="300" kv="25" forcerange="-80 80"/>
<position name="a2" joint="j2" kp="600" kv="40" forcerange="-120 120"/>
<position name="a3" joint="j3" kp="300" kv="20" forcerange="-80 80"/>
<position name="a4" joint="j4" kp="60" kv="3" forcerange="-20 20"/>
<position name="a5" joint="j5" kp="40" kv="2" forcerange="-20 20"/>
<position name="a6" joint="j6" kp="20" kv=".6" forcerange="-10 10"/></actuator></mujoco>"""
FRICTION = (3.0, 4.0, 2.5, 0.8, 0.6, 0.3)
ROTOR = (0.3, 0.4, 0.2, 0.05, 0.03, 0.015)
MASS, AT = 0.8, (0.06, 0.0, 0.02)


def recordings() -> list[Recording]:
    """Ten runs of six seconds at 100 Hz under sums of sines, two of them held out."""
    spec = mujoco.MjSpec.from_string(LINKS)
    for i, (friction, rotor) in enumerate(zip(FRICTION, ROTOR, strict=True)):
        joint = spec.joint(f"j{i + 1}")
        joint.frictionloss, joint.armature = friction, rotor
    payload = spec.body("l6").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], pos=AT)
    payload.mass, payload.contype, payload.conaffinity = MASS, 0, 0
    spec.option.timestep = 0.0005
    model, rng, out = spec.compile(), np.random.default_rng(0), []
    for k in range(10):
        data = mujoco.MjData(model)
        data.qpos[:] = start = rng.uniform(-0.4, 0.4, 6)
        mujoco.mj_forward(model, data)
        frequency, phase, size = (rng.uniform(a, b, (3, 6)) for a, b in ((0.15, 1.2), (0, 6.3), (0.1, 0.45)))
        rows = []
        for t in np.arange(601) / 100:
            wave = size * (np.sin(2 * np.pi * frequency * t + phase) - np.sin(phase))
            u = start + wave.sum(0) * min(1.0, 2.0 * t)
            q, v = (x + s * rng.standard_normal(6) for x, s in ((data.qpos, 1e-4), (data.qvel, 3e-3)))
            rows.append((t, q, v, u))
            data.ctrl[:] = u
            mujoco.mj_step(model, data, 20)
        name = f"heldout_{k}" if k > 7 else f"run_{k}"
        out.append(Recording(name, *(np.array(x) for x in zip(*rows, strict=True))))
    return out


@pytest.mark.slow
def test_thirteen_effects_on_one_arm():
    d = diagnose(mujoco.MjSpec.from_string(LINKS), recordings(), Config(jobs=os.cpu_count() or 1))
    parts = {str(t): x for t, x in d.fit.hypothesis.split(d.ctx, d.fit.theta).items()}
    expected = {f"{effect}@j{i + 1}" for effect in ("coulomb_friction", "armature") for i in range(6)}
    assert set(parts) == expected | {"payload_mass@l6"}
    for i, (friction, rotor) in enumerate(zip(FRICTION, ROTOR, strict=True)):
        assert parts[f"coulomb_friction@j{i + 1}"][0] == pytest.approx(friction, rel=0.1)
        assert parts[f"armature@j{i + 1}"][0] == pytest.approx(rotor, rel=0.1)
    np.testing.assert_allclose(parts["payload_mass@l6"], (MASS, *AT), rtol=0.1, atol=0.005)
    assert d.held.before.rms > 10 * d.held.after.rms
