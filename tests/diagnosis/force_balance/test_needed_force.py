"""Actuator forces that a motion needs, by hand."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance import needed_force
from mpge_jax.diagnosis.force_balance.needed_force import can_ask, needed
from mpge_jax.diagnosis.force_balance.tracks import Track
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.single_step import Machine
from tests.diagnosis.machines import ARM, PENDULUM, ROTORS

GEAR = 20.0
GEARED = PENDULUM.replace('joint="hinge" ctrl', f'joint="hinge" gear="{GEAR}" ctrl')
LEVER = 0.5 * 9.81 * 0.15
"""Torque (N m) of the pendulum's weight when it lies level."""


def _machine(xml, parts=()):
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    terms = tuple(Term(i, find_place(ctx, REGISTRY[i], at)) for i, at, _ in parts)
    return Machine.build(ctx, terms, tuple(np.array(theta, float) for _, _, theta in parts))


def _track(machine, qpos, qvel, qacc, unsure=1e-4):
    q, v, a = (np.atleast_2d(np.asarray(x, float).T).T for x in (qpos, qvel, qacc))
    time, force = 0.01 * np.arange(len(q)), np.zeros((len(q), machine.model.nu))
    return Track("r", time, q, v, a, np.full_like(v, unsure), force)


def _needed(machine, *states):
    return needed(machine, _track(machine, *states))[1:]


def test_force_is_that_of_gravity_and_inertia_before_the_gear():
    q = np.array([0.0, 0.3, -0.7])
    still = _needed(_machine(GEARED), q, 0 * q, 0 * q)
    # a positive angle about y swings the rod to -x; gravity pulls it back
    np.testing.assert_allclose(still[:, 0], LEVER * np.sin(q[1:]) / GEAR, rtol=1e-6)
    model = compile_variable(mujoco.MjSpec.from_string(GEARED))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.qacc[0] = 0.3, 2.0, 5.0
    mujoco.mj_inverse(model, data)
    moving = _needed(_machine(GEARED), [0.3, 0.3], [2.0, 2.0], [5.0, 5.0])
    assert moving[0, 0] == pytest.approx(data.qfrc_inverse[0] / GEAR)


@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_friction_adds_to_the_force(speed):
    states = ([0.3] * 8, [speed] * 8, [0.0] * 8)
    plain = GEAR * _needed(_machine(GEARED), *states)[-1, 0]
    sign = np.sign(speed)
    dry = _needed(_machine(GEARED, [("coulomb_friction", "hinge", [0.1])]), *states)
    assert GEAR * dry[-1, 0] - plain == pytest.approx(0.1 * sign, rel=1e-2)
    drag = _needed(_machine(GEARED, [("quadratic_drag", "hinge", [0.05])]), *states)
    assert GEAR * drag[-1, 0] - plain == pytest.approx(0.05 * 4.0 * sign)
    # torque = plain + (0.02 + 0.2 |torque|) sgn v, solved for the torque
    load = _needed(_machine(GEARED, [("load_dependent_friction", "hinge", [0.02, 0.2])]), *states)
    lifts = np.sign(plain + 0.02 * sign) * sign
    assert GEAR * load[-1, 0] == pytest.approx((plain + 0.02 * sign) / (1 - 0.2 * lifts), rel=2e-2)


def test_forces_at_sites_and_outside_forces():
    flat = np.zeros((3, 3))
    hover = _needed(_machine(ROTORS), flat, flat, flat)
    np.testing.assert_allclose(hover, 0.5 * 0.8 * 9.81, rtol=1e-6)
    lifted = _machine(ROTORS, [("external_force", "drone", [0.0, 0.0, 1.0])])
    np.testing.assert_allclose(_needed(lifted, flat, flat, flat), 0.5 * (0.8 * 9.81 - 1.0), rtol=1e-6)


def test_the_velocity_of_a_body_is_that_of_its_centre_of_mass():
    machine = _machine(PENDULUM, [("quadratic_drag", "arm", [1.0])])
    rigid = needed_force.Rigid(machine.model, _track(machine, [0.0], [1.0], [0.0]), [1])
    np.testing.assert_allclose(rigid.velocity[1], [[-0.15, 0.0, 0.0]], atol=1e-9)


def test_what_was_computed_for_one_machine_is_not_taken_for_another():
    plain, heavy = _machine(GEARED), _machine(GEARED, [("mass_scale", "world", [2.0])])
    dry = _machine(GEARED, [("mass_scale", "world", [2.0]), ("coulomb_friction", "hinge", [0.1])])
    track, known = _track(plain, [0.3] * 4, [2.0] * 4, [0.0] * 4), {}
    for machine in (plain, heavy, dry, plain, dry):
        np.testing.assert_array_equal(needed(machine, track, known), needed(machine, track))
    assert len(known) <= 2


def test_all_effects_that_can_be_asked_change_the_forces():
    """And those that cannot are the ones of commands, contacts, and memories that the motion does not tell."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    plain = Machine.build(ctx, (), ())
    t = np.linspace(0, 3, 60)
    track = _track(plain, np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t))
    asked = [t for t in all_terms(ctx) if can_ask(t)]
    for term in asked:
        scales = np.array([p.scale for p in term.params(ctx)])
        machine = Machine.build(ctx, (term,), (term.effect.starts(ctx, term.place)[-1] + 0.1 * scales,))
        assert np.abs(needed(machine, track) - needed(plain, track)).max() > 1e-6, term
    not_asked = {t.name for t in all_terms(ctx)} - {t.name for t in asked}
    assert not_asked == {
        "dead_actuator", "back_emf", "torque_saturation", "actuator_deadzone", "actuator_delay", "actuator_lag",
        "joint_flexibility", "backlash",
    }  # fmt: skip


def test_a_sensor_that_is_off_is_no_reason_to_reuse_what_was_known():
    machine = _machine(ARM, [("encoder_offset", "shoulder", [0.1])])
    track, known = _track(machine, np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((4, 2))), {}
    force = needed(machine, track, known)
    assert known == {} and not np.allclose(force, needed(_machine(ARM), track))
    assert set(needed_force.MEASURES) == {"actuator_gain", "actuator_bias"}


@pytest.mark.parametrize("flag", ["", '<flag damper="disable"/>'])
def test_rotor_inertia_and_damping_are_those_of_the_engine_and_ask_it_for_nothing(flag):
    direct = ARM.replace('implicitfast"/>', f'implicitfast">{flag}</option>').replace(
        '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>',
        '<motor name="elbow_motor" joint="elbow"/>',
    )
    plain = _machine(direct)
    t = np.linspace(0.0, 2.0, 30)[:, None] * [3.0, 4.0]
    track, known = _track(plain, np.sin(t), [3.0, 4.0] * np.cos(t), [-9.0, -16.0] * np.sin(t)), {}
    needed(plain, track, known)
    computed = list(known)
    more = [
        ("armature", "elbow", [0.3]),
        ("viscous_damping", "shoulder", [0.7]),
        ("armature", "shoulder", [0.2]),
    ]
    machine = _machine(direct, more)
    found, data, want = needed(machine, track, known), mujoco.MjData(machine.model), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(track.q, track.v, track.a, strict=True):
        mujoco.mj_inverse(machine.model, data)
        want.append(data.qfrc_inverse.copy())
    np.testing.assert_allclose(found, want, atol=1e-10)
    assert np.abs(found - needed(plain, track)).max() > 1.0 and list(known) == computed
