"""The benchmark's physics against numbers worked out by hand."""

import math

import numpy as np
import pytest

from experiments.blind.truth.physics import INSTALL, stages_of
from experiments.blind.truth.physics.joint import BRISTLE, CREEP
from experiments.blind.truth.plant import Plant
from experiments.blind.truth.sensors import Sensors
from experiments.blind.truth.simulate import simulate
from experiments.blind.vocabulary import PARAMETERS, Effect

SLIDER = """
<mujoco><option timestep="0.002" gravity="0 0 {gravity}"/><worldbody>
  <body name="block"><joint name="s" type="slide" axis="{axis}" armature="{armature}"/>
    <geom name="g" type="box" size="0.1 0.1 0.1" mass="2" contype="0" conaffinity="0"/></body>
</worldbody><actuator>{actuator}</actuator></mujoco>
"""
MOTOR = '<motor name="m" joint="s" gear="3" ctrllimited="true" ctrlrange="-10 10"/>'
DT = 0.0005


@pytest.fixture
def plant(tmp_path):
    """A 2 kg block on a frictionless rail, with effects."""

    def make(
        *effects: Effect,
        actuator: str = MOTOR,
        axis: str = "1 0 0",
        gravity: float = 0,
        armature: float = 0,
        law: str = "at once",
    ):
        path = tmp_path / "slider.xml"
        path.write_text(SLIDER.format(actuator=actuator, axis=axis, gravity=gravity, armature=armature))
        return Plant(str(path), DT, "Euler", stages_of(effects, law))

    return make


def run(plant: Plant, steps: int, command=lambda t: 0.0, v: float = 0.0, q: float = 0.0):
    """Positions, velocities and forces of every sub-step, command stages included."""
    plant.reset(np.array([q]), np.array([v]))
    out = []
    for k in range(steps):
        wish = np.array([command(k * plant.dt)])
        for stage in plant.stages.command:
            wish = stage(plant, wish)
        plant.substep(wish)
        qpos, qvel = plant.state()
        out.append((qpos[0], qvel[0], plant.force[0]))
    return np.array(out).T


def test_every_effect_has_physics():
    assert set(PARAMETERS) <= set(INSTALL)
    assert len(PARAMETERS) == 28


def test_force_and_gear_of_the_plain_machine(plant):
    _, v, force = run(plant(), 100, lambda t: 4.0)
    assert force[-1] == 4.0  # actuator_force is before the gear
    assert v[-1] == pytest.approx(4 * 3 / 2 * 100 * DT)  # v = F t / m


def test_command_is_clipped_and_servo_law_is_kept(plant):
    _, _, force = run(plant(), 2, lambda t: 99.0)
    assert force[0] == 10.0
    servo = '<position name="m" joint="s" kp="7" kv="0.5"/>'
    _, _, force = run(plant(actuator=servo), 1, lambda t: 0.4, v=2.0, q=0.1)
    assert force[0] == pytest.approx(7 * (0.4 - 0.1) - 0.5 * 2.0)


def test_coulomb_friction_decelerates_by_force_over_mass_then_sticks(plant):
    p = plant(Effect("coulomb_friction", "s", {"torque": 3.0}))
    _, v, _ = run(p, 3000, v=1.2)
    stop = round(1.2 / (3.0 / 2) / DT)  # v0 / (Fc / m) = 0.8 s
    assert np.allclose(np.diff(v[: stop - 2]), -3.0 / 2 * DT, atol=1e-12)
    assert np.abs(v[stop + 1 :]).max() < 1e-12


def test_coulomb_friction_holds_a_smaller_force_exactly(plant):
    p = plant(Effect("coulomb_friction", "s", {"torque": 3.0}))
    q, _, _ = run(p, 2000, lambda t: 0.99)  # 0.99 * gear 3 = 2.97 N
    assert np.abs(q).max() < 1e-12
    _, v, _ = run(p, 1000, lambda t: 1.5)  # (4.5 - 3) / 2 m/s^2
    assert v[-1] == pytest.approx(0.75 * 1000 * DT)


def test_creeping_friction_never_sticks(plant):
    p = plant(Effect("coulomb_friction", "s", {"torque": 3.0}), law="creeping")
    _, v, _ = run(p, 2000, lambda t: 0.5)  # half of what it holds: tanh(v / v0) = 0.5
    assert v[-1] == pytest.approx(CREEP * math.atanh(0.5), rel=0.02)
    _, v, _ = run(p, 100, v=1.2)
    assert np.allclose(np.diff(v), -3.0 / 2 * DT, atol=1e-12)


def test_friction_that_sets_in_after_a_way(plant):
    p = plant(Effect("coulomb_friction", "s", {"torque": 3.0}), law="after a way")
    for _ in range(2):  # it forgets
        q, v, _ = run(p, 40, v=1.2)
        way = v[0] * DT + np.abs(
            q[1:-1]
        )  # counted from the first sub-step on, whose speed it sees after the next one
        expected = -1.5 * DT * -np.expm1(-way / BRISTLE)
        np.testing.assert_allclose(np.diff(v)[1:], expected, rtol=0.2)
    q, v, _ = run(p, 400, lambda t: -6.0, v=0.1)
    turn = int(np.flatnonzero(v < 0)[0])
    braked = np.diff(v) / DT + 9.0  # -18 N on 2 kg without friction
    assert braked[turn] < 0.1 and braked[-1] == pytest.approx(1.5, rel=0.01)


def test_viscous_damping_and_drag(plant):
    _, v, _ = run(plant(Effect("viscous_damping", "s", {"coefficient": 4.0})), 1000, v=1.0)
    assert v[-1] == pytest.approx(math.exp(-4 / 2 * 0.5), rel=2e-3)
    _, v, _ = run(plant(Effect("quadratic_drag", "s", {"coefficient": 4.0})), 1000, v=-1.0)
    assert v[-1] == pytest.approx(-1 / (1 + 4 / 2 * 0.5), rel=2e-3)
    _, body, _ = run(plant(Effect("quadratic_drag", "block", {"coefficient": 4.0})), 1000, v=-1.0)
    assert np.allclose(body, v, atol=1e-9)


def test_stribeck_falls_with_speed(plant):
    p = plant(Effect("stribeck_friction", "s", {"coulomb": 1.0, "static": 3.0, "velocity": 0.2}))
    for speed in (0.05, 0.2, 1.0):
        _, v, _ = run(p, 1, v=speed)
        level = 1 + 2 * math.exp(-((speed / 0.2) ** 2))
        assert (speed - v[0]) / DT == pytest.approx(level / 2)
    assert np.abs(run(p, 500, lambda t: 0.99)[0]).max() < 1e-12  # 2.97 N < static 3 N


def test_load_dependent_friction_uses_force_times_gear(plant):
    p = plant(Effect("load_dependent_friction", "s", {"coulomb": 1.0, "load_coefficient": 0.1}))
    _, v, _ = run(p, 1, lambda t: -2.0, v=1.0)  # load = |-2 * 3| = 6, friction 1.6
    assert (v[0] - 1) / DT == pytest.approx((-6 - 1.6) / 2)


def test_asymmetric_friction(plant):
    p = plant(
        Effect(
            "asymmetric_friction",
            "s",
            {
                "coulomb_forward": 1.0,
                "coulomb_backward": 2.0,
                "viscous_forward": 0.5,
                "viscous_backward": 3.0,
            },
        )
    )
    assert (run(p, 1, v=2.0)[1][0] - 2) / DT == pytest.approx(-(1 + 0.5 * 2) / 2)
    assert (run(p, 1, v=-2.0)[1][0] + 2) / DT == pytest.approx((2 + 3 * 2) / 2)
    assert np.abs(run(p, 100, lambda t: 0.33)[0]).max() < 1e-12  # +0.99 N held by 1 N
    assert np.abs(run(p, 100, lambda t: -0.66)[0]).max() < 1e-12  # -1.98 N held by 2 N
    assert run(p, 100, lambda t: 0.4)[1][-1] > 0


def test_two_frictions_stick_together(tmp_path):
    xml = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom fromto="0 0 0 0.3 0 0" type="capsule"
      size="0.02" mass="1"/><body pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom fromto="0 0 0 0.3 0 0"
      type="capsule" size="0.02" mass="1"/></body></body></worldbody></mujoco>"""
    path = tmp_path / "arm.xml"
    path.write_text(xml)
    hold = [Effect("coulomb_friction", j, {"torque": 8.0}) for j in "ab"]
    p = Plant(str(path), DT, "Euler", stages_of(hold))
    p.reset(np.array([0.0, 0.0]), np.zeros(2))
    for _ in range(200):
        p.substep(np.zeros(0))
    assert np.abs(p.state()[0]).max() < 1e-9  # gravity needs 5.9 N m and 1.5 N m


def test_stiffness_cogging_armature(plant):
    stiff = Effect("joint_stiffness", "s", {"stiffness": 5.0, "reference": 0.2})
    assert run(plant(stiff), 1, q=0.5)[1][0] / DT == pytest.approx(-5 * 0.3 / 2)
    cog = Effect("cogging_torque", "s", {"amplitude": 5.0, "periods": 7.0, "phase": 0.3})
    assert run(plant(cog), 1, q=0.5)[1][0] / DT == pytest.approx(5 * math.sin(7 * 0.5 + 0.3) / 2)
    heavy = Effect("armature", "s", {"inertia": 1.5})
    assert run(plant(heavy), 1, lambda t: 1.0)[1][0] / DT == pytest.approx(3 / 3.5)


def test_actuator_force_effects(plant):
    def force(effect: str, command: float, **parameters: float) -> float:
        return run(plant(Effect(effect, "m", parameters)), 1, lambda t: command)[2][0]

    assert force("actuator_gain", 4.0, gain=0.7) == pytest.approx(2.8)
    assert force("dead_actuator", 4.0) == 0.0
    assert force("actuator_bias", 10.0, bias=1.5) == 11.5  # added after the clip of the command
    assert force("torque_saturation", 9.0, limit=6.0) == 6.0
    assert force("torque_saturation", -9.0, limit=6.0) == -6.0
    assert force("actuator_deadzone", 0.4, width=0.5) == 0.0
    assert force("actuator_deadzone", -2.0, width=0.5) == -1.5


def test_deadzone_is_continuous(plant):
    p = plant(Effect("actuator_deadzone", "m", {"width": 0.5}))
    force = run(p, 2001, lambda t: -1 + 2 * t)[2]  # a ramp of 2 a second in steps of 0.001
    assert np.abs(np.diff(force)).max() <= 2 * DT + 1e-12
    assert force[0] == -0.5


def test_back_emf_brakes_by_gain_times_coefficient(plant):
    p = plant(Effect("back_emf", "m", {"coefficient": 0.3}))
    assert run(p, 1, lambda t: 2.0, v=1.5)[2][0] == pytest.approx(2.0 - 0.3 * 1.5)


def test_delay_is_exact(plant):
    p = plant(Effect("actuator_delay", "m", {"delay": 0.02}))
    wave = lambda t: math.sin(9 * t)  # noqa: E731
    force = run(p, 400, wave)[2]
    assert np.allclose(force[40:], [wave((k - 40) * DT) for k in range(40, 400)], atol=1e-12)
    assert np.all(force[:40] == wave(0))
    assert np.allclose(run(p, 400, wave)[2], force)  # a reset empties the line


def test_lag_step_response(plant):
    p = plant(Effect("actuator_lag", "m", {"time_constant": 0.05}))
    force = run(p, 400, lambda t: 0.0 if t == 0 else 2.0)[2]
    t = (np.arange(400) - 1) * DT
    assert np.allclose(force[1:], 2 * (1 - np.exp(-t[1:] / 0.05)), atol=1e-12)


def test_masses_and_gravity(plant):
    up = {"axis": "0 0 1", "gravity": -10.0}

    def acceleration(*effects: Effect) -> float:
        return run(plant(*effects, **up), 1, lambda t: 4.0)[1][0] / DT

    assert acceleration() == pytest.approx(12 / 2 - 10)
    assert acceleration(Effect("mass_scale", "world", {"factor": 1.5})) == pytest.approx(12 / 3 - 10)
    payload = Effect("payload_mass", "block", {"mass": 1.0, "position": [0.1, 0.0, 0.0]})
    assert acceleration(payload) == pytest.approx(12 / 3 - 10)
    tilt = Effect("gravity_tilt", "world", {"angle": 0.3, "axis": [0.0, 1.0, 0.0]})
    assert acceleration(tilt) == pytest.approx(12 / 2 - 10 * math.cos(0.3))
    side = run(plant(tilt, gravity=-10.0), 1)[1][0] / DT  # rotating -z about +y points to -x
    assert side == pytest.approx(-10 * math.sin(0.3))
    wind = Effect("external_force", "block", {"force": [5.0, 0.0, 1.0]})
    assert acceleration(wind) == pytest.approx(13 / 2 - 10)


ROD = """<mujoco><option gravity="0 0 -10"/><worldbody><body name="rod"><joint name="h" axis="0 1 0" armature="0.02"/>
  <inertial pos="0 0 -0.5" mass="2" diaginertia="0.1 0.1 0.001"/></body></worldbody>
  <actuator><motor name="m" joint="h"/></actuator></mujoco>"""


def rod(tmp_path, *effects: Effect) -> Plant:
    path = tmp_path / "rod.xml"
    path.write_text(ROD)
    return Plant(str(path), DT, "Euler", stages_of(effects))


def test_payload_and_com_offset_on_a_rod(tmp_path):
    q = 0.4
    gravity, inertia = 2 * 10 * 0.5, 0.1 + 2 * 0.25 + 0.02
    assert run(rod(tmp_path), 1, q=q)[1][0] / DT == pytest.approx(-gravity * math.sin(q) / inertia)
    payload = Effect("payload_mass", "rod", {"mass": 0.5, "position": [0.0, 0.0, -0.8]})
    expected = -(gravity + 0.5 * 10 * 0.8) * math.sin(q) / (inertia + 0.5 * 0.64)
    assert run(rod(tmp_path, payload), 1, q=q)[1][0] / DT == pytest.approx(expected, rel=1e-6)
    offset = Effect("com_offset", "rod", {"offset": [0.0, 0.0, -0.1]})
    expected = -2 * 10 * 0.6 * math.sin(q) / (0.1 + 2 * 0.36 + 0.02)
    assert run(rod(tmp_path, offset), 1, q=q)[1][0] / DT == pytest.approx(expected, rel=1e-6)


def test_backlash_lets_the_motor_travel_freely(tmp_path):
    p = rod(tmp_path, Effect("backlash", "h", {"gap": 0.06}))
    p.reset(np.array([0.0]), np.array([0.0]))
    rotor, inertia = "rotor of h", 0.02
    while p.q(rotor) < 0.029:
        p.substep(np.array([1.0]))
    assert abs(p.q("h")) < 1e-9  # the link has not felt anything yet
    assert p.v(rotor) == pytest.approx(math.sqrt(2 * 1.0 / inertia * p.q(rotor)), rel=0.01)
    for _ in range(12000):
        p.substep(np.array([1.0 - 3.0 * p.v("h")]))
    assert p.q(rotor) - p.q("h") == pytest.approx(0.03, abs=1e-3)  # half the gap, then carried along
    assert p.q("h") == pytest.approx(math.asin(1.0 / 10.0), abs=5e-3)


def test_flexibility_has_its_static_twist(tmp_path):
    p = rod(tmp_path, Effect("joint_flexibility", "h", {"stiffness": 20.0, "damping": 0.5}))
    p.reset(np.array([0.0]), np.array([0.0]))
    for _ in range(12000):
        p.substep(np.array([2.0 - 3.0 * p.v("h")]))
    assert p.q("h") == pytest.approx(math.asin(2.0 / 10.0), abs=1e-3)
    assert p.q("rotor of h") - p.q("h") == pytest.approx(2.0 / 20.0, abs=1e-3)


def test_stiff_transmissions_are_the_nominal_machine(tmp_path):
    """Damping in the model's default class must not be given to the rotor as well."""
    path = tmp_path / "default.xml"
    path.write_text(
        ROD.replace("<worldbody>", '<default><joint damping="0.3" stiffness="2"/></default><worldbody>')
    )
    ends = []
    for effect in (
        None,
        Effect("joint_flexibility", "h", {"stiffness": 1e4, "damping": 2.0}),
        Effect("backlash", "h", {"gap": 1e-7}),
    ):
        p = Plant(str(path), 0.0002, "Euler", stages_of([effect] if effect else []))
        p.reset(np.array([0.8]), np.array([1.0]))
        for _ in range(2500):
            p.substep(np.array([1.0]))
        ends.append(p.state()[0][0])
    assert ends[1:] == pytest.approx([ends[0]] * 2, abs=2e-3)


def test_contact_friction_decelerates_by_mu_g(tmp_path):
    xml = """<mujoco><option gravity="0 0 -10" cone="elliptic"/><worldbody><geom name="floor" type="plane" size="0 0 1"
      friction="0.5 0 0"/><body name="b" pos="0 0 0.1"><freejoint name="f"/><geom name="box" type="box"
      size="0.2 0.2 0.1" mass="1" friction="0.5 0 0"/></body></worldbody></mujoco>"""
    path = tmp_path / "box.xml"
    path.write_text(xml)
    for at in ("world", "box"):
        p = Plant(str(path), DT, "Euler", stages_of([Effect("contact_friction", at, {"mu": 0.2})]))
        p.reset(np.array([0, 0, 0.0999, 1, 0, 0, 0.0]), np.zeros(6))
        for _ in range(500):
            p.substep(np.zeros(0))
        p.data.qvel[0] = 1.5
        for _ in range(400):
            p.substep(np.zeros(0))
        assert p.state()[1][0] == pytest.approx(1.5 - 0.2 * 10 * 0.2, abs=0.02)


def test_sensor_effects_change_the_measurement_only(plant):
    ticks = np.arange(0, 600, 10)
    command = np.sin(np.arange(60) / 5.0)[:, None]

    def record(*effects: Effect):
        p = plant(*effects)
        start = (np.zeros(1), np.array([0.3]))
        return simulate(p, command, ticks, 0, start, Sensors(noise=0.0), np.random.default_rng(0))

    plain = record()
    assert np.allclose(record(Effect("encoder_offset", "s", {"offset": 0.05})).qpos, plain.qpos + 0.05)
    late = record(Effect("sensor_delay", "s", {"delay": 0.015}))  # three rows of 5 ms
    assert np.allclose(late.qpos[3:], plain.qpos[:-3])
    assert np.allclose(late.qvel[3:], plain.qvel[:-3])
    assert np.allclose(late.force, plain.force)


def test_effect_refuses_wrong_names():
    with pytest.raises(ValueError, match="unknown effect"):
        Effect("friction", "s", {})
    with pytest.raises(ValueError, match="takes"):
        Effect("coulomb_friction", "s", {"level": 1.0})
