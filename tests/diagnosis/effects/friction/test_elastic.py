"""Dry friction that gives way before it slides."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.corrected.corrected_model import CStepper
from mpge_jax.diagnosis.effects.candidates import all_terms, compatible
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.single_step import Machine, force_start, force_step
from tests.diagnosis.effects.friction.steps import at_speed
from tests.diagnosis.machines import PENDULUM

ID = "coulomb_friction:elastic"
SLIDER = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="hinge" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def slider(form: str, *theta: float) -> Machine:
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(SLIDER)))
    (place,) = REGISTRY[form].places(ctx)
    return Machine.build(ctx, (Term(form, place),), (np.array(theta),))


def forces(machine: Machine, v: np.ndarray, inertia: float, dt: float) -> np.ndarray:
    """Force of friction along velocities [T]."""
    memory, out = None, []
    for speed in v:
        step = at_speed(machine, speed, inertia=inertia, dt=dt)
        applied, memory = force_step(
            np, machine, step, force_start(np, machine, step) if memory is None else memory
        )
        out.append(float(applied.qfrc[0]))
    return np.array(out)


def test_it_is_a_spring_until_it_slides_and_comes_back_along_the_same_spring():
    """3 N, 0.01 m/N: after 0.01 m to and fro from rest, far below 0.03 m, so slowly that nothing is damped."""
    dt, inertia = 1e-3, 2.0
    v = np.concatenate([np.full(1000, 0.01), np.full(5000, 0.01), np.full(1000, -0.01)])
    force = -forces(slider(ID, 3.0, 0.01, 0.3), v, inertia, dt)
    # d(force)/dx = 100 N/m at first, and what is left of it as 1 - force / 3 N while it bends further
    damped = 2 * 0.3 * np.sqrt(100 * inertia) * 0.01
    assert force[0] == pytest.approx(100 * 1e-5 + damped, rel=1e-3)
    assert force[999] == pytest.approx(
        3.0 * (1 - np.exp(-0.01 / 0.03)) + damped * np.exp(-0.01 / 0.03), rel=2e-3
    )
    assert force[5999] == pytest.approx(3.0 * (1 - np.exp(-2)) + damped * np.exp(-2), rel=2e-3)
    # unloading is steeper than loading was: (1 + force / 3 N) times the spring
    bent = 3.0 * (1 - np.exp(-2))
    assert force[6000] + damped * (1 + bent / 3.0) == pytest.approx(bent - 1e-3 * (1 + bent / 3.0), rel=2e-3)


def test_sliding_it_is_its_law():
    v = np.full(4000, 0.5)
    for form, theta in (("coulomb_friction", [3.0]), ("stribeck_friction", [3.0, 1.0, 0.4])):
        plain = 3.0 if len(theta) == 1 else 3.0 + np.exp(-((0.5 / 0.4) ** 2))
        assert forces(slider(f"{form}:elastic", *theta, 1e-3, 0.3), v, 2.0, 1e-3)[-1] == pytest.approx(-plain)
    both = slider("asymmetric_friction:elastic", 3.0, 5.0, 2.0, 4.0, 1e-3, 0.3)
    assert forces(both, v, 2.0, 1e-3)[-1] == pytest.approx(-3.0 - 2.0 * 0.5)
    assert forces(both, -v, 2.0, 1e-3)[-1] == pytest.approx(5.0 + 4.0 * 0.5)


def test_without_compliance_it_moves_as_its_law_does():
    """Pushed back and forth by more and by less than the friction, as far as steps of 1 ms tell the two apart."""
    paths = []
    for machine in (slider("coulomb_friction", 3.0), slider(ID, 3.0, 0.0, 0.3)):
        stepper = CStepper(machine)
        stepper.reset(np.zeros(1), np.zeros(1))
        path = []
        for k in range(3000):
            stepper.step(np.array([6.0 * np.sin(0.004 * k)]))
            path.append(float(stepper.measured()[0]))
        paths.append(np.array(path))
    assert np.ptp(paths[0]) > 0.2
    np.testing.assert_allclose(*paths, atol=0.01 * np.ptp(paths[0]))


def test_it_takes_the_place_of_its_law_and_is_reported_under_its_name():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    (place,) = REGISTRY[ID].places(ctx)
    elastic, plain, damping = (Term(i, place) for i in (ID, "stribeck_friction", "viscous_damping"))
    assert elastic.name == elastic.plain == "coulomb_friction"
    assert Term("load_dependent_friction:gear:elastic", place).plain == "load_dependent_friction:gear"
    assert not compatible(Hypothesis.of(elastic), plain) and not compatible(Hypothesis.of(plain), elastic)
    assert compatible(Hypothesis.of(elastic), damping)
    # it is no candidate by itself
    assert all(t.id == t.plain for t in all_terms(ctx))
    text = elastic.effect.sentence(
        place, {"torque": "3 N m", "stiffness": "100 N m/rad", "damping_ratio": "0.3"}
    )
    assert "dry friction of 3 N m" in text and "gives way like a spring of 100 N m/rad" in text
    for wrong in ("viscous_damping:elastic", "coulomb_friction:behind_gap:elastic", "coulomb_friction:soft"):
        with pytest.raises(KeyError):
            REGISTRY[wrong]
