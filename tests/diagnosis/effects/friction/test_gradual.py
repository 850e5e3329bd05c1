"""Dry friction that sets in gradually with the speed."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY, Config, diagnose
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.closer_forms import closer
from mpge_jax.diagnosis.simulation.single_step import force_step
from tests.diagnosis.effects.friction.steps import at_speed
from tests.diagnosis.effects.friction.test_falling import machine
from tests.diagnosis.machines import PENDULUM, really_sticks, record
from tests.diagnosis.searches import COULOMB, fitted, search_of

ID = "coulomb_friction:gradual"
LEVEL, VELOCITY = 0.1, 0.4


def friction(speed: float, *theta: float) -> float:
    m = machine(ID, *theta)
    applied, _ = force_step(np, m, at_speed(m, speed, 0.0), ((),))
    return float(applied.dry[0])


@pytest.mark.parametrize(
    ("speed", "share"), [(0.0, 0.0), (0.4, np.tanh(1.0)), (-0.4, np.tanh(1.0)), (8.0, 1.0)]
)
def test_its_level_is_reached_with_the_speed(speed, share):
    assert friction(speed, LEVEL, VELOCITY) == pytest.approx(LEVEL * share)


def test_it_is_no_steeper_than_a_step_can_follow():
    """At a velocity of none it is dry friction but for the speed that a step of this force takes away."""
    steepest = friction(1e-6, LEVEL, 0.0) / 1e-6
    assert friction(1e-6, LEVEL, 1e-9) / 1e-6 == steepest < friction(1e-6, 0.5 * LEVEL, 0.0) / 1e-6 * 1.01
    assert friction(1.0, LEVEL, 0.0) == pytest.approx(LEVEL)


def test_it_is_found_where_friction_creeps():
    def creeps(model, data) -> None:
        v = float(data.qvel[0])
        data.qfrc_applied[0] -= LEVEL * np.tanh(v / VELOCITY)

    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, force=creeps, seconds=3.0))
    better = final_fit(s, closer(s, fitted(s, {COULOMB: [0.8 * LEVEL]})))[0]
    assert [t.id for t in better.hypothesis.terms] == [ID]
    assert better.theta == pytest.approx([LEVEL, VELOCITY], rel=0.1)


def test_it_is_dry_friction_in_reports():
    m = machine(ID, LEVEL, VELOCITY)
    (term,) = m.terms
    assert term.name == term.plain == "coulomb_friction"
    values = term.effect.report(m.ctx, term.place, np.array([LEVEL, VELOCITY]))
    assert values == {"torque": LEVEL, "velocity": VELOCITY}
    text = term.effect.sentence(term.place, {"torque": "0.1 N m", "velocity": "0.4 rad/s"})
    assert text.endswith("which sets in gradually: it has reached three quarters of that at 0.4 rad/s.")
    assert REGISTRY[ID].equation == "-Fc tanh(v/vs)"


@pytest.mark.parametrize("damping", [0.01, pytest.param(0.05, marks=pytest.mark.slow)])
def test_dry_friction_and_damping_are_not_taken_for_it(damping):
    def rub(model) -> None:
        model.dof_frictionloss[0] = LEVEL
        model.dof_damping[0] += damping
        really_sticks(model, 0)

    config = Config(jobs=1, quiet=True, effects=("coulomb_friction", "viscous_damping"))
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), record(PENDULUM, 0.8, rub, seconds=3.0), config)
    assert sorted(t.id for t in d.terms) == ["coulomb_friction", "viscous_damping"]
    assert d.fit.theta == pytest.approx([LEVEL, damping], rel=0.05)
