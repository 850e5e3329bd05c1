"""What servos' forces do between rows, against simulation and by hand."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.force_between_rows import bends, nominal

TWO = """<mujoco><option timestep="0.00002" gravity="0 0 0"/>
<default><geom contype="0" conaffinity="0" mass=".2"/></default><worldbody>
<body><joint name="a" axis="0 1 0" damping=".05" armature=".01"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size=".02"/>
<body pos="0.2 0 0"><joint name="b" axis="0 1 0" damping=".05"/>
<geom type="capsule" fromto="0 0 0 0.15 0 0" size=".02"/></body></body></worldbody>
<actuator><position name="sa" joint="a" kp="20" kv="0.6"/>
<position name="sb" joint="b" gear="2" kp="2" kv="0.04" forcerange="-0.9 0.9"/></actuator></mujoco>"""
ROW = 0.01


def _recorded(model: mujoco.MjModel) -> tuple[Recording, States, np.ndarray]:
    """Rows every 10 ms, and the mean forces [T - 1, 2] between them."""
    data, rows, felt = mujoco.MjData(model), [], []
    for i in range(120):
        data.ctrl[:] = 0.8 * np.sin(3.0 * ROW * i * np.array([1.0, 1.7])) + 0.3 * np.sign(np.sin(0.4 * i))
        mujoco.mj_forward(model, data)
        rows.append([data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.actuator_force.copy()])
        forces = []
        for _ in range(round(ROW / model.opt.timestep)):
            mujoco.mj_step(model, data)
            forces.append(data.actuator_force.copy())
        felt.append(np.mean(forces, axis=0))
    q, v, u, f = (np.array(x) for x in zip(*rows, strict=True))
    r = Recording("r", ROW * np.arange(len(q)), q, None, u, f)
    return r, States(q, v, 0 * v, np.zeros((len(q), 2, 2, 2))), np.array(felt[:-1])


def test_a_servos_force_bends_between_rows_as_its_joint_accelerates():
    model = mujoco.MjModel.from_xml_string(TWO)
    r, states, felt = _recorded(model)
    law = nominal(r, states, model)
    smooth = r.force - np.cumsum(law.jumps, axis=0)
    limited = np.abs(r.force[:, 1]) >= 0.9 - 1e-9
    assert 10 < limited.sum() < 80
    assert not law.slopes[limited, 1].any()
    np.testing.assert_allclose(law.slopes[~limited][0], [[-20.0, -0.6], [-2.0, -0.04]])
    bend = bends(model, r, states, smooth, law)
    straight, bent = (Source.build(r, states, r.force, smooth, bend=x) for x in (None, bend))
    inside = ~(limited[:-1] | limited[1:])
    off = [
        np.sqrt(np.mean((np.diff(s.integral, axis=0) / ROW - felt)[inside] ** 2, axis=0))
        for s in (straight, bent)
    ]
    assert (off[1] < 0.3 * off[0]).all(), off


def test_nothing_bends_where_rows_are_missing():
    model = mujoco.MjModel.from_xml_string(TWO)
    r, states, _ = _recorded(model)
    time = r.time + np.where(np.arange(r.time.size) > 50, 1.0, 0.0)
    gap = Recording("r", time, r.qpos, None, r.ctrl, r.force)
    law = nominal(gap, states, model)
    bend = bends(model, gap, states, r.force - np.cumsum(law.jumps, axis=0), law)
    assert not bend[50].any()
    assert bend[49].any()


def test_means_of_a_force_that_bends_are_exact():
    """f = 1 + 2 t + 3 t^2 on two rows a second apart has the second derivative 6."""
    time = np.array([0.0, 1.0, 2.0])
    states = States(np.zeros((3, 1)), np.zeros((3, 1)), np.zeros((3, 1)), np.zeros((3, 1, 2, 2)))
    force = (1 + 2 * time + 3 * time**2)[:, None]
    source = Source.build(
        Recording("r", time, np.zeros((3, 1)), None, force), states, force, force, bend=np.full((2, 1), 6.0)
    )
    edges = np.array([0.0, 0.25, 0.5, 1.5, 2.0])
    integral = edges + edges**2 + edges**3
    np.testing.assert_allclose(source.mean_command(edges)[:, 0], np.diff(integral) / np.diff(edges))


def test_forces_with_an_age_can_be_made_older():
    time = np.array([0.0, 1.0, 2.0, 3.0])
    states = States(np.zeros((4, 1)), np.zeros((4, 1)), np.zeros((4, 1)), np.zeros((4, 1, 2, 2)))
    force = time[:, None]
    r = Recording("r", time, np.zeros((4, 1)), None, force)
    source = Source.build(r, states, force, force, np.array([0.2]))
    edges = np.array([1.0, 2.0])
    assert source.mean_command(edges)[0, 0] == pytest.approx(1.3)
    assert source.older(2.0).mean_command(edges)[0, 0] == pytest.approx(1.1)


def test_an_aged_force_that_bends_is_the_same_force_later():
    """f = 3 t^2, a fifth of a row late."""
    time = np.arange(5.0)
    states = States(np.zeros((5, 1)), np.zeros((5, 1)), np.zeros((5, 1)), np.zeros((5, 1, 2, 2)))
    force = (3 * time**2)[:, None]
    r = Recording("r", time, np.zeros((5, 1)), None, force)
    source = Source.build(r, states, force, force, np.array([0.2]), bend=np.full((4, 1), 6.0))
    edges = np.array([1.0, 1.5, 3.0])
    np.testing.assert_allclose(source.mean_command(edges)[:, 0], np.diff((edges - 0.2) ** 3) / np.diff(edges))


@pytest.mark.parametrize(
    ("kv", "inertia", "share"), [(1.0, 0.1, 0.02), (100.0, 0.1, 0.02), (400.0, 0.1, 0.02)]
)
def test_a_stiff_servos_force_relaxes_within_a_row(kv, inertia, share):
    """A joint that spins into a servo which damps it: the force falls as exp(-kv t / M)."""
    xml = f"""<mujoco><option timestep="0.00001" gravity="0 0 0" integrator="implicitfast"/><worldbody><body>
    <joint name="a" armature="{inertia}"/><geom size=".01" mass="1e-6" contype="0" conaffinity="0"/></body>
    </worldbody>
    <actuator><position name="s" joint="a" kp="1" kv="{kv}"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data, rows, felt = mujoco.MjData(model), [], []
    data.qvel[0] = 1.0
    for _ in range(3):
        mujoco.mj_forward(model, data)
        rows.append([data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.actuator_force.copy()])
        forces = []
        for _ in range(1000):
            mujoco.mj_step(model, data)
            forces.append(float(data.actuator_force[0]))
        felt.append(np.mean(forces))
    q, v, u, f = (np.array(x) for x in zip(*rows, strict=True))
    r, states = Recording("r", ROW * np.arange(3), q, None, u, f), States(q, v, 0 * v, np.zeros((3, 1, 2, 2)))
    bend = bends(model, r, states, f, nominal(r, states, model))
    mean = np.diff(Source.build(r, states, f, f, bend=bend).integral[:, 0])[0] / ROW
    assert mean == pytest.approx(felt[0], abs=share * abs(f[0, 0]))
