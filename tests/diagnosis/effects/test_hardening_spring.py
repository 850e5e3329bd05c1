"""A spring that is not linear."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.closer_forms import closer
from mpge_jax.diagnosis.simulation.single_step import Machine, force_start, force_step, observe
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import HINGE, fitted, reported, search_of

ID, PLAIN = "joint_stiffness:hardening", Term("joint_stiffness", HINGE)
STIFFNESS, REFERENCE, CUBIC = 0.8, 0.2, 0.5


def test_it_adds_the_cube_of_its_deflection_to_the_linear_spring():
    """0.8 N m/rad towards 0.2 rad and 0.5 N m/rad^3: at 0.7 rad the cube makes 0.0625 N m."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    theta = REGISTRY[ID].from_report(
        ctx, HINGE, {"stiffness": STIFFNESS, "reference": REFERENCE, "cubic": CUBIC}
    )
    machine, zero = Machine.build(ctx, (Term(ID, HINGE),), (theta,)), np.zeros(1)
    assert machine.model.jnt_stiffness[0] == pytest.approx(STIFFNESS)
    assert machine.model.qpos_spring[0] == pytest.approx(REFERENCE)
    for q, force in ((0.7, -0.0625), (-0.3, 0.0625), (REFERENCE, 0.0)):
        step = observe(
            np, machine, np.array([q]), zero, zero, lambda _: np.zeros(3), zero, 0.01, zero, lambda _: 1.0
        )
        applied, _ = force_step(np, machine, step, force_start(np, machine, step))
        assert applied.qfrc[0] == pytest.approx(force, abs=1e-12)


def test_it_is_asked_for_where_a_spring_stands():
    def spring(cubic: float):
        def change(model: mujoco.MjModel) -> None:
            model.jnt_stiffness[0], model.qpos_spring[0] = STIFFNESS, REFERENCE

        def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[0] -= cubic * (data.qpos[0] - REFERENCE) ** 3

        return search_of(PENDULUM, record(PENDULUM, 0.8, change=change, force=force, seconds=3.0))[0]

    for cubic in (CUBIC, 0.0):
        s = spring(cubic)
        plain, _ = final_fit(s, fitted(s, {PLAIN: [STIFFNESS, STIFFNESS * REFERENCE]}))
        found = closer(s, plain)
        if not cubic:
            assert found is plain
            continue
        values = reported(s, found)
        assert found.hypothesis.terms[0].id == ID and values["cubic"] == pytest.approx(CUBIC, rel=0.05)
        assert values["stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
