"""Dry friction that falls from rest to sliding, on top of another law."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.candidates import all_terms, compatible
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.single_step import Machine, force_step
from tests.diagnosis.effects.friction.steps import at_speed
from tests.diagnosis.machines import PENDULUM

LOAD = "load_dependent_friction"
ID = f"{LOAD}:falling"


def machine(form: str, *theta: float) -> Machine:
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    (place,) = REGISTRY[form].places(ctx)
    return Machine.build(ctx, (Term(form, place),), (np.array(theta),))


def friction(m: Machine, speed: float, command: float) -> float:
    """Level of dry friction at a speed (rad/s), under the motor's force (N m)."""
    step = at_speed(m, speed, command)
    applied, _ = force_step(np, m, step, ((),))
    return float(applied.dry[0])


@pytest.mark.parametrize(
    ("speed", "more"),
    [(0.0, 1.5), (0.4, 1.0 + 0.5 * np.exp(-1.0)), (-0.4, 1.0 + 0.5 * np.exp(-1.0)), (8.0, 1.0)],
)
def test_it_is_its_law_and_a_share_of_that_more_at_rest(speed, more):
    """0.2 N m and a tenth of 1.5 N m of load, half as much more at rest, falling by 0.4 rad/s."""
    assert friction(machine(ID, 0.2, 0.1, 0.5, 0.4), speed, 1.5) == pytest.approx(0.35 * more)
    assert friction(machine(LOAD, 0.2, 0.1), speed, 1.5) == pytest.approx(0.35)


def test_it_is_reported_under_the_name_of_its_law_and_takes_its_place():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    (place,) = REGISTRY[ID].places(ctx)
    term, plain, damping = (Term(i, place) for i in (ID, LOAD, "viscous_damping"))
    assert term.name == term.plain == LOAD
    assert not compatible(Hypothesis.of(term), plain) and compatible(Hypothesis.of(term), damping)
    assert all(t.id == t.plain for t in all_terms(ctx))
    values = term.effect.report(ctx, place, np.array([0.2, 0.1, 0.5, 0.4]))
    assert values["static_ratio"] == 1.5 and values["velocity"] == 0.4
    shown = {"coulomb": "0.2 N m", "load_coefficient": "0.1", "static_ratio": "1.5", "velocity": "0.4 rad/s"}
    text = term.effect.sentence(place, shown)
    assert "at rest that is 1.5 times as large, and falls until about 0.4 rad/s" in text
    with pytest.raises(KeyError):
        # plain dry friction that falls is stribeck_friction
        REGISTRY["coulomb_friction:falling"]
