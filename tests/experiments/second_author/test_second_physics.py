"""The second author's physics beside what one computes by hand, on a block on a rail and on a link."""

import mujoco
import numpy as np
import pytest

from experiments.second_author.bodies import Drag, Payload, Tilt
from experiments.second_author.drives import Deadzone, Delay, GroundEffect, Lag, SensorDelay
from experiments.second_author.joints import Backlash, Coulomb, Dahl, Flexible, Stribeck, Viscous
from experiments.second_author.movers import quadrotor
from experiments.second_author.simulation import Sim

DT, MASS = 0.002, 2.0
BLOCK = f"""<mujoco><option timestep="{DT}" gravity="0 0 -9.81"/>
<worldbody><body name="block"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="{MASS}"/></body>
</worldbody><actuator><motor name="push" joint="rail"/></actuator></mujoco>"""


def moving(*effects, v=0.0, q=0.0):
    sim = Sim(BLOCK, effects, DT)
    sim.reset(np.array([q]), np.array([v]))
    return sim


def driven(sim, *commands):
    """What arrives at the drive of each command."""
    out = []
    for u in commands:
        sim.step(np.array([u], float))
        out.append(sim.d.ctrl[0])
    return out


def test_viscous_damping_is_a_force_of_its_coefficient_times_the_velocity():
    sim = moving(Viscous("rail", 0.5), v=3.0)
    assert sim.d.qfrc_passive[0] == pytest.approx(-1.5)


def test_dry_friction_holds_up_to_its_limit_and_takes_it_off_beyond():
    held, slides = moving(Coulomb("rail", 1.0)), moving(Coulomb("rail", 1.0))
    for _ in range(500):
        held.step(np.array([0.9]))
        slides.step(np.array([1.5]))
    assert abs(held.link()[1][0]) < 1e-3
    assert slides.link()[1][0] == pytest.approx((1.5 - 1.0) / MASS * 500 * DT, rel=1e-2)


def test_stribeck_friction_falls_with_speed():
    sim = moving(Stribeck("rail", 1.0, 3.0, 0.5), v=0.5)
    sim.step(np.zeros(1))
    assert sim.m.dof_frictionloss[0] == pytest.approx(1.0 + 2.0 * np.exp(-1.0))


def test_a_delay_holds_commands_back_by_whole_steps():
    assert driven(moving(Delay("push", 3 * DT)), 1, 2, 3, 4, 5, 6) == [1, 1, 1, 1, 2, 3]


def test_a_late_sensor_reads_what_was_steps_ago():
    sim = moving(SensorDelay("rail", 3 * DT), v=1.0)
    read = []
    for _ in range(6):
        sim.step(np.zeros(1))
        read.append(sim.measured()[0][0])
    # the first step is what it knows first
    assert read == pytest.approx([DT, DT, DT, DT, 2 * DT, 3 * DT])


def test_a_lag_approaches_a_step_exponentially():
    sim = moving(Lag("push", 0.01))
    driven(sim, 0.0)
    driven(sim, *[1.0] * 5)
    assert sim.effects[0].state == pytest.approx(1 - np.exp(-5 * DT / 0.01))


def test_a_dead_zone_takes_its_width_off():
    assert driven(moving(Deadzone("push", 0.1)), 0.3, 0.05, -0.3) == pytest.approx([0.2, 0.0, -0.2])


def test_drag_grows_with_the_square_of_the_speed():
    sim = moving(Drag("block", 0.25), v=-4.0)
    sim.step(np.zeros(1))
    assert sim.d.xfrc_applied[sim.m.body("block").id, :3] == pytest.approx([4.0, 0, 0])


def test_a_payload_and_a_tilt_change_what_is_weighed():
    assert moving(Payload("block", 0.5, [0.1, 0, 0])).m.body_subtreemass[1] == pytest.approx(MASS + 0.5)
    gravity = moving(Tilt(0.1, [0.0, 1.0, 0.0])).m.opt.gravity
    assert gravity == pytest.approx([-9.81 * np.sin(0.1), 0.0, -9.81 * np.cos(0.1)])


def test_a_gap_is_free_within_and_pushes_back_beyond():
    for apart, force in ((0.015, 0.0), (0.03, -40.0), (-0.03, 40.0)):
        sim = moving(Backlash("rail", 0.04, 0.25, 4000.0, 0.002))
        sim.d.qpos[sim.column("rail_second")] = apart
        sim.effects[0].before(sim)
        assert sim.d.qfrc_applied[sim.dof("rail_second")] == pytest.approx(force)
        assert sim.link()[0] == pytest.approx([apart]) and sim.at_motors(sim.link()[0]) == pytest.approx([0])


def test_a_flexible_joint_is_a_spring_between_motor_and_link():
    sim = moving(Flexible("rail", 55.0, 0.04))
    sim.d.qpos[sim.column("rail_second")] = 0.1
    mujoco.mj_forward(sim.m, sim.d)
    assert sim.d.qfrc_passive[sim.dof("rail_second")] == pytest.approx(-5.5)


def test_cables_are_a_spring_at_first_and_then_slip():
    cable = Dahl("rail", 0.05, 0.25)
    sim = moving(cable, v=1.0)
    cable.before(sim)
    assert cable.state == pytest.approx(DT * 0.05 / 0.25)
    for _ in range(2000):
        cable.before(sim)
    assert cable.state == pytest.approx(0.05)


def test_thrust_grows_near_the_floor():
    effect = GroundEffect("frame", 0.024)
    sim = Sim(quadrotor(), [effect])
    sim.reset(np.array([0, 0, 0.048, 1, 0, 0, 0]), np.zeros(6))
    assert effect.command(sim, np.full(4, 3.0)) == pytest.approx(np.full(4, 4.0))
