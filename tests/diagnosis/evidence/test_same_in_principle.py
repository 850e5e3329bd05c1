"""What the table says of pairs of effects is true of their motions."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.evidence.same_in_principle import TABLE, same
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from tests.diagnosis.machines import ARM, PENDULUM, record
from tests.diagnosis.searches import prepared_of

BARE = PENDULUM.replace('damping="0.02" armature="0.004"', "")
DOUBLE = ARM.replace(
    '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>',
    '<motor name="elbow_motor" joint="elbow"/>',
)
RATIO, DELAY, TILT, COEFFICIENT = 0.3, 0.02, 0.1, 0.05


def terms_of(xml: str) -> dict[str, Term]:
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    # the first place of each: the root's joint, its motor and body
    return {t.id: t for t in reversed(all_terms(ctx, None))}


def percussion() -> list[float]:
    """A mass on the pendulum that lets inertia and weight grow by one ratio: mass, and where it sits."""
    m = mujoco.MjModel.from_xml_string(BARE)
    weight = float(m.body_mass[1] * -m.body_ipos[1, 2])
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    inertia = float(data.qM[0]) if hasattr(data, "qM") else float(data.M[0])
    length = inertia / weight
    return [RATIO * weight / length, 0.0, 0.0, -length]


CASES = {
    ("actuator_delay", "sensor_delay"): (PENDULUM, [DELAY], [DELAY], 0.1),
    ("gravity_tilt", "encoder_offset"): (DOUBLE, None, [TILT], 1e-6),
    ("viscous_damping", "back_emf"): (PENDULUM, [COEFFICIENT], [COEFFICIENT], 1e-6),
    ("payload_mass", "actuator_gain"): (BARE, percussion(), [1 / (1 + RATIO)], 1e-6),
    ("mass_scale", "actuator_gain"): (BARE, [1 + RATIO], [1 / (1 + RATIO)], 1e-6),
}


def test_every_pair_is_tried():
    assert set(CASES) == set(TABLE)


@pytest.mark.parametrize("pair", CASES, ids=" and ".join)
def test_effects_that_are_the_same_move_the_machine_alike(pair):
    xml, one, other, tolerance = CASES[pair]
    known = terms_of(xml)
    a, b = (known[name] for name in pair)
    p = prepared_of(xml, record(xml, 0.5, noise=1e-7))
    assert same(p.ctx, a, b) and same(p.ctx, b, a)
    if one is None:
        # the two components across gravity of a turn about the hinge
        one = [x for x in ([TILT, 0.0], [-TILT, 0.0], [0.0, TILT], [0.0, -TILT])]
    w = p.windows("train", 0.5, 4)
    runs = [Run(Hypothesis(), np.zeros(0)), Run(Hypothesis.of(b), np.array(other))]
    runs += [Run(Hypothesis.of(a), np.array(x)) for x in (one if isinstance(one[0], list) else [one])]
    plain, second, *first = p.sim.residuals(runs, w)[..., : p.model.nv]
    effect = np.sqrt(np.nanmean((second - plain) ** 2))
    apart = min(np.sqrt(np.nanmean((x - second) ** 2)) for x in first)
    assert effect > 1e-3 and apart < tolerance * effect


@pytest.mark.parametrize(
    ("pair", "xml"),
    [
        # the elbow's motion tells the shoulder's encoder from its motor
        (("actuator_delay", "sensor_delay"), DOUBLE),
        (
            ("gravity_tilt", "encoder_offset"),
            DOUBLE.replace('name="elbow" axis="0 1 0"', 'name="elbow" axis="1 0 0"'),
        ),
        (("payload_mass", "actuator_gain"), DOUBLE),
        (("mass_scale", "actuator_gain"), DOUBLE),
        (("viscous_damping", "coulomb_friction"), PENDULUM),
    ],
)
def test_elsewhere_the_data_decide(pair, xml):
    known = terms_of(xml)
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    assert not same(ctx, *(known[name] for name in pair))


def test_damping_is_not_the_back_emf_of_another_joints_motor():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(DOUBLE)))
    terms = all_terms(ctx, ("viscous_damping", "back_emf"))
    places = {(t.id, t.place.name): t for t in terms}
    emf = places["back_emf", "elbow_motor"]
    assert same(ctx, places["viscous_damping", "elbow"], emf)
    assert not same(ctx, places["viscous_damping", "shoulder"], emf)
