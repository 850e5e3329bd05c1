"""A payload that is no point."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.closer_forms import closer
from mpge_jax.diagnosis.simulation.single_step import Machine
from tests.diagnosis.machines import ARM, PENDULUM, record
from tests.diagnosis.searches import fitted, reported, search_of

ID = "payload_mass:extended"
MASS, AT, RADIUS = 0.3, np.array([0.05, 0.0, -0.2]), 0.12


def test_it_adds_its_own_inertia_about_every_axis():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    place = find_place(ctx, REGISTRY[ID], "arm")
    inertia = []
    for form, theta in (("payload_mass", [MASS, *AT]), (ID, [MASS, *AT, RADIUS])):
        model = Machine.build(ctx, (Term(form, place),), (np.array(theta),)).model
        inertia.append((float(model.dof_M0[0]), float(model.body_mass[1]), model.body_ipos[1].copy()))
        assert np.linalg.eigvalsh(np.diag(model.body_inertia[1])).min() > 0
    (point, *same), (extended, *too) = inertia
    assert extended - point == pytest.approx(MASS * RADIUS**2)
    assert same[0] == too[0] and same[1].tolist() == too[1].tolist()


def test_an_extent_is_found_where_there_is_one_and_not_where_there_is_none():
    def loaded(radius: float):
        def change(model: mujoco.MjModel) -> None:
            ctx = nominal_context(model)
            term = Term(ID, find_place(ctx, REGISTRY[ID], "fore"))
            moved = Machine.build(ctx, (term,), (np.array([MASS, *AT, radius]),)).model
            for field in REGISTRY[ID].fields:
                getattr(model, field)[:] = getattr(moved, field)

        return search_of(ARM, record(ARM, [4.0, 0.8], change=change, seconds=3.0))[0]

    for radius in (RADIUS, 0.0):
        s = loaded(radius)
        point = Term("payload_mass", find_place(s.sim.ctx, REGISTRY["payload_mass"], "fore"))
        found = closer(s, final_fit(s, fitted(s, {point: [MASS, *AT]}))[0])
        (term,) = found.hypothesis.terms
        assert term.plain == term.name == "payload_mass"
        if not radius:
            assert term == point
            continue
        values = reported(s, found)
        assert values["mass"] == pytest.approx(MASS, rel=0.03)
        assert values["gyration_radius"] == pytest.approx(RADIUS, rel=0.05)
