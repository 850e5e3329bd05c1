"""The effect that holds what no other explains: bounded, harmless beyond what was seen, the same everywhere."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual, splines
from mpge_jax.diagnosis.effects.residual.since_turn import SinceTurn, travelled
from mpge_jax.diagnosis.effects.step import Step
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import compile_variable
from tests.diagnosis.machines import ARM, PENDULUM
from tests.diagnosis.searches import HINGE

CTX = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
COUPLED = Residual((Axis("q", -1.0, 1.0, "elbow"), Axis("v", -3.0, 3.0)), 3.0)
OF_BOTH = Residual((Axis("q", -1.0, 1.0), Axis("v", -3.0, 3.0)), 3.0)
ROUGH = Residual((Axis("q", -1.0, 1.0),), 3.0, dry=True)
FINE = ROUGH.told_by((18,))
BENDS = SinceTurn(Axis.since_turn(0.05), 3.0)
NOTCHES = Residual((Axis.within_turn(6),), 3.0).told_by((12,))
FINE_TRAVEL = BENDS.told_by((18,))


def step(q: float, v: float, f: float = 0.0) -> Step:
    none = np.zeros(1)
    return Step(
        np.array([q]), np.array([v]), none, np.array([f]), none, none, none, none, none, lambda _: none, 0.01
    )


def force(effect: Residual, theta, *state: float) -> float:
    return float(effect.force(np, CTX, HINGE, np.asarray(theta), step(*state), ())[0].joint)


def test_splines_share_out_one_and_stay_at_their_ends():
    x = np.linspace(-2.0, 3.0, 23)
    parts = np.array(splines(np, x, 9))
    np.testing.assert_allclose(parts.sum(0), 1.0)
    np.testing.assert_allclose(
        parts[:, x < 0], parts[:, [np.argmin(np.abs(x))]] * np.ones(int((x < 0).sum())), atol=0.2
    )
    np.testing.assert_array_equal(np.array(splines(np, np.array([-5.0]), 9)), splines(np, np.array([0.0]), 9))
    # values on a straight line are a straight line: the third knot's value stands at the third of seven knots
    values = np.arange(9.0) - 1.0
    assert float(
        sum(v * s for v, s in zip(values, splines(np, np.array(2 / 6), 9), strict=True))
    ) == pytest.approx(2.0)


def test_around_a_turn_they_have_no_ends():
    x = np.random.default_rng(0).uniform(-2.0, 3.0, 200)
    parts = np.array(splines(np, x, 9, around=True))
    np.testing.assert_allclose(parts.sum(0), 1.0)
    np.testing.assert_allclose(parts, splines(np, x + 1.0, 9, around=True), atol=1e-12)
    # each is the one before it, a ninth of a turn on
    np.testing.assert_allclose(parts[4], np.array(splines(np, x + 1.0 / 9, 9, around=True))[5], atol=1e-12)
    np.testing.assert_allclose(parts[0], np.array(splines(np, x + 1.0 / 9, 9, around=True))[1], atol=1e-12)


def test_what_repeats_in_a_turn_is_the_same_after_each_part():
    theta, turn = np.random.default_rng(1).normal(size=12), 2 * np.pi
    for q in np.linspace(-40.0, 40.0, 9):
        here = force(NOTCHES, theta, q, 0.0)
        assert force(NOTCHES, theta, q + turn / 6, 0.0) == pytest.approx(here)
        assert force(NOTCHES, theta, q + 50 * turn, 0.0) == pytest.approx(here)
    assert np.ptp([force(NOTCHES, theta, q, 0.0) for q in np.linspace(0, turn / 6, 20)]) > 0.5
    (axis,) = NOTCHES.axes
    assert (axis.parts, axis.key, axis.letter) == (6, "q", "q")
    assert axis.within(np.array([-0.1]))[0] == pytest.approx(turn / 6 - 0.1)


def test_beyond_what_was_seen_it_is_bounded_and_only_brakes():
    effect = Residual((Axis("v", -3.0, 3.0),), 3.0)
    pushes = np.full(9, 0.7)
    assert force(effect, pushes, 0.0, 2.9) == pytest.approx(0.7)
    assert force(effect, pushes, 0.0, 3.75) == pytest.approx(0.35)
    assert force(effect, pushes, 0.0, 9.0) == 0.0
    assert force(effect, pushes, 0.0, -9.0) == pytest.approx(0.7)
    far = np.random.default_rng(0).normal(size=OF_BOTH.size)
    assert all(abs(force(OF_BOTH, far, q, 0.0)) <= np.abs(far).max() for q in np.linspace(-50, 50, 11))


def test_an_identifier_says_it_all():
    for effect in (
        OF_BOTH,
        Residual((Axis("f", -0.25, 1.5),), 0.5),
        Residual((Axis("l", -1e-3, 1e3),), 12.0),
        FINE,
        FINE_TRAVEL,
        COUPLED,
        NOTCHES,
        Residual((Axis.within_turn(), Axis("v", -1.0, 1.0)), 3.0),
        ROUGH,
        BENDS,
    ):
        again = REGISTRY[effect.id]
        assert again.id == effect.id and again.axes == effect.axes and again.below == effect.below
        assert again.dry == effect.dry and again.counts == effect.counts
    assert OF_BOTH.id not in list(REGISTRY) and OF_BOTH.id.partition(":")[0] == "residual"
    assert (
        FINE.size,
        OF_BOTH.size,
        Residual((Axis("q", 0.0, 1.0, knots=7), Axis("v", 0.0, 1.0)), 3.0).size,
    ) == (18, 36, 42)
    broken = (
        "residual:q[0,1,3]below 3",
        "residual:q[1,0]below 3",
        "residual:x[0,1]below 3",
        "residual:q[0,1]",
        "residual",
        "other",
    )
    # a travel goes as far one way as the other, is the joint's own, alone, and no level of dry friction
    turned = ("z[-0.1,0.2]", "z@elbow[-0.1,0.1]", "z[-0.1,0.1]q[0,1]", "dry:z[-0.1,0.1]")
    turned += ("a[0,1]", "a@elbow[0,6.28319]")
    for wrong in (*broken, *(f"residual:{x}below 3" for x in turned)):
        with pytest.raises(KeyError):
            REGISTRY[wrong]
    with pytest.raises(KeyError):
        REGISTRY["residual:l@elbow[0,1]below 3"]
    with pytest.raises(ValueError, match="only input"):
        Residual(BENDS.axes, 3.0)
    with pytest.raises(ValueError, match="depends on z"):
        SinceTurn(Axis("q", -1.0, 1.0), 3.0)
    for wrong in (
        ("z", -1.0, 2.0),
        ("q", 0.0, float("nan")),
        ("l", 0.0, 1.0, "elbow"),
        ("q", 0.0, 1.0, "el[bow"),
        ("q", 0.0, 1.0, "", 3),
        ("a", 0.0, 2.0),
    ):
        with pytest.raises(ValueError, match="one of a, q, v, f, l, z with a range"):
            Axis(*wrong)


def test_a_coupling_reads_the_other_joint():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(ARM)))
    shoulder, elbow = (Place("joint", name, k) for k, name in enumerate(ctx.names.joints))
    none = np.zeros(2)
    s = Step(
        np.array([0.5, -0.2]), np.array([1.0, 2.0]), none, np.array([3.0, 4.0]),
        none, none, none, none, none, lambda _: none, 0.01,
    )  # fmt: skip
    assert COUPLED.coupled and not OF_BOTH.coupled
    assert [float(x) for x in COUPLED.inputs(ctx, shoulder, s)] == [-0.2, 1.0]
    assert float(Residual((Axis("f", -9.0, 9.0, "shoulder"),), 3.0).inputs(ctx, elbow, s)[0]) == 3.0
    first, second = COUPLED.axes
    assert (first.letter, first.says) == ("q(elbow)", "position of the elbow")
    assert (second.letter, second.says, second.unit(ctx, shoulder)) == ("v", "speed of the joint", "rad/s")
    with pytest.raises(ValueError, match="no joint 'elbow'"):
        COUPLED.inputs(CTX, HINGE, step(0.0, 0.0))


CROSSTALK = Residual((Axis("f", -3.0, 3.0, "shoulder"), Axis("v", -5.0, 5.0, "shoulder")), 9.0)


def table(values: list[float], effect: Residual = OF_BOTH, at: str = "hinge") -> list[dict[str, object]]:
    return [
        {
            "id": "residual",
            "form": effect.id,
            "at": at,
            "kind": "joint",
            "parameters": {"values": values},
        }
    ]


def test_its_force_is_the_same_in_numpy_and_in_jax():
    rng = np.random.default_rng(0)
    theta = rng.normal(size=OF_BOTH.size).astype(np.float32)
    for q, v in rng.uniform(-5, 5, (20, 2)):
        s = step(q, v)
        s = dataclasses.replace(s, q=jnp.array(s.q), v=jnp.array(s.v))
        told = OF_BOTH.force(jnp, CTX, HINGE, jnp.array(theta), s, ())[0].joint
        assert float(told) == pytest.approx(force(OF_BOTH, theta, q, v), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("xml", "effect", "at", "size"),
    [
        (PENDULUM, OF_BOTH, "hinge", 0.2),
        (ARM, CROSSTALK, "elbow", 2.0),
        (PENDULUM, ROUGH, "hinge", 0.1),
        (PENDULUM, BENDS, "hinge", 0.1),
        (PENDULUM, NOTCHES, "hinge", 0.2),
    ],
    ids=["own", "coupled", "dry", "since a turn", "within a turn"],
)
def test_it_moves_the_machine_alike_in_c_and_in_jax(xml, effect, at, size):
    values = list(size * np.random.default_rng(0).normal(size=effect.size))
    corrected = CorrectedModel.build(mujoco.MjSpec.from_string(xml), table(values, effect, at))
    c, plain = corrected.c_stepper(), CorrectedModel.build(mujoco.MjSpec.from_string(xml), []).c_stepper()
    engine = corrected.jax_engine("mjx")
    some = np.ones(c.model.nv)
    data = engine.init(jnp.array(0.3 * some), jnp.array(some))
    for stepper in (c, plain):
        stepper.reset(0.3 * some, some)
        stepper.step(0.1 * some, 40)
    data = engine.step(data, jnp.array(0.1 * some), 40)
    assert abs(c.data.qpos[-1] - plain.data.qpos[-1]) > 1e-3
    np.testing.assert_allclose(data.qpos, c.data.qpos, atol=2e-5)


def test_dry_friction_is_a_level_beside_any_that_is_named_and_never_drives():
    """Half a Coulomb friction of 0.2 N m where a function takes 0.1 off, and none where it takes more off."""
    friction = {"id": "coulomb_friction", "form": "coulomb_friction", "at": "hinge", "kind": "joint"}
    friction["parameters"] = {"torque": 0.2}
    levels = []
    for less in (0.0, -0.1, -0.5):
        rows = [friction, *table([less] * ROUGH.size, ROUGH)]
        stepper = CorrectedModel.build(mujoco.MjSpec.from_string(PENDULUM), rows).c_stepper()
        stepper.reset(np.array([0.2]), np.array([1.0]))
        stepper.step(np.zeros(1), 1)
        levels.append(float(stepper.model.dof_frictionloss[0]))
    assert levels == pytest.approx([0.2, 0.1, 0.0])


def test_travel_since_a_turn_goes_from_one_end_to_the_other():
    q = np.array([0.0, 0.03, 0.06, 0.09, 0.08, 0.02, 0.02, 0.03])
    want = np.array([0.0, 0.03, 0.05, 0.05, 0.04, -0.02, -0.02, -0.01])
    np.testing.assert_allclose(travelled(q, 0.05), want, atol=1e-15)
    theta = np.random.default_rng(0).normal(size=BENDS.size)
    along = BENDS.along(CTX, HINGE, theta, q[:, None])
    np.testing.assert_allclose(along, BENDS.value(np, theta, [want]))
    # step by step it is the same
    memory, told = BENDS.memory(np, CTX, HINGE, theta, step(0.0, 0.0)), []
    for v in np.diff(q, prepend=0.0) / 0.01:
        forces, memory = BENDS.force(np, CTX, HINGE, theta, step(0.0, v), memory)
        told.append(float(forces.joint))
    fast = np.abs(np.diff(q, prepend=0.0) / 0.01) > BENDS.below
    np.testing.assert_allclose(np.array(told)[~fast], along[~fast])


def test_what_dry_friction_does_is_against_the_motion():
    values = {"q": np.zeros(3), "v": np.array([2.0, -1.0, 0.0])}
    np.testing.assert_array_equal(ROUGH.against(values), [-1.0, 1.0, 0.0])
    np.testing.assert_array_equal(OF_BOTH.against(values), np.ones(3))


def test_values_are_as_many_as_its_splines():
    with pytest.raises(InputError, match="36 values, not 3"):
        CorrectedModel.build(mujoco.MjSpec.from_string(PENDULUM), table([1.0, 2.0, 3.0]))
