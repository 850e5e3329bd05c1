"""Effects written as MJCF, and machines rebuilt from tables."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec
from tests.diagnosis.machines import ARM, PENDULUM
from tests.diagnosis.searches import exported


@pytest.mark.parametrize("settings", ["", '<compiler inertiafromgeom="true"/>'])
def test_exported_effects_add_up(settings):
    """Each effect is added to what the ones before it left, as in the machine on which they act together."""
    model, machine = exported(
        ARM.replace("<option", f"{settings}<option"),
        {
            "mass_scale": ("world", [1.5]),
            "payload_mass": ("fore", [0.2, 0.0, 0.0, -0.25]),
            "com_offset": ("fore", [0.0, 0.01, 0.0]),
            "gravity_tilt": ("world", [0.1, 0.05]),
            "external_force": ("world", [1.0, 0.0, 0.0]),
            "actuator_gain": ("shoulder_motor", [0.8]),
            "actuator_bias": ("shoulder_motor", [0.3]),
        },
    )
    assert model.body_mass[2] == pytest.approx(1.5 * machine.ctx.model.body_mass[2] + 0.2)
    for name in ("body_mass", "body_ipos", "body_inertia", "actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_allclose(getattr(model, name), getattr(machine.model, name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(model.opt.gravity, machine.model.opt.gravity, rtol=1e-12)


def test_springs_of_models_in_degrees_are_exported_in_degrees():
    xml = PENDULUM.replace("<option", '<compiler angle="degree"/><option')
    xml = xml.replace('name="hinge"', 'name="hinge" stiffness="0.3" springref="20"')
    model, machine = exported(xml, {"joint_stiffness": ("hinge", [0.6, 0.1])})
    # springs in parallel: 0.3 at 20 degrees and 0.6 at 0.1 / 0.6 rad
    assert model.jnt_stiffness[0] == pytest.approx(0.9)
    assert model.qpos_spring[0] == pytest.approx((0.3 * np.deg2rad(20) + 0.1) / 0.9)
    assert machine.model.qpos_spring[0] == pytest.approx(model.qpos_spring[0])


def test_damping_ratios_stay_the_damping_that_was_fitted():
    """A heavier arm has the servo's old damping, not the old ratio."""
    xml = PENDULUM.replace("<motor", '<position kp="20" dampratio="1"')
    damping = compile_variable(mujoco.MjSpec.from_string(xml)).actuator_biasprm[0, 2]
    ctx = nominal_context(compile_variable(load_spec(mujoco.MjSpec.from_string(xml))))
    spec = load_spec(mujoco.MjSpec.from_string(xml))
    spec.compile()
    effect = REGISTRY["armature"]
    assert effect.export(spec, ctx, effect.places(ctx)[0], np.array([0.05]))
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert damping < 0 and again.actuator_biasprm[0, 2] == pytest.approx(damping, rel=1e-5)


def test_places_of_one_name_are_told_apart_by_their_kind():
    xml = PENDULUM.replace('body name="arm"', 'body name="hinge"')
    entry = {"id": "quadratic_drag", "at": "hinge", "parameters": {"coefficient": 0.1}}
    kinds = [
        CorrectedModel.build(mujoco.MjSpec.from_string(xml), [entry | k]).machine.terms[0].place.kind
        for k in ({"kind": "body"}, {"kind": "joint"}, {})
    ]
    assert kinds == ["body", "joint", "joint"]


def test_a_dead_muscle_can_be_written():
    xml = PENDULUM.replace("<motor", '<muscle lengthrange="-2 2"').replace(
        'ctrlrange="-2 2"', 'ctrlrange="0 1"'
    )
    model, _ = exported(xml, {"dead_actuator": ("motor", [])})
    data = mujoco.MjData(model)
    data.ctrl[:], data.act[:] = 1.0, 1.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == 0.0
