"""What people read: one rival an effect and place, numbers without noise digits."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from machines import PENDULUM

from mpge_jax.diagnosis.actuator_side import ActuatorSide
from mpge_jax.diagnosis.effects.base import Place, nominal_context
from mpge_jax.diagnosis.export import corrected_spec
from mpge_jax.diagnosis.fit import Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.model import compile_variable
from mpge_jax.diagnosis.outputs import effects_table
from mpge_jax.diagnosis.rivals import _one_each
from mpge_jax.diagnosis.select import Rival
from mpge_jax.diagnosis.words import quantity


def test_forms_of_a_rival_are_one_entry_and_ties_win():
    nothing = Fitted(Hypothesis(), np.zeros(0), np.zeros(0))
    elbow, wrist = Place("joint", "elbow", 0), Place("joint", "wrist", 1)

    def rival(name: str, place: Place, margin: float, tied: bool = False) -> Rival:
        return Rival(Term(name, place), nothing, margin, 0.1, "", tied)

    plain, gear = "load_dependent_friction", "load_dependent_friction:gear"
    rivals = [rival(gear, elbow, 0.1), rival(plain, elbow, 0.2), rival(plain, wrist, 0.3)]
    assert _one_each(rivals) == [rivals[0], rivals[2]]
    tied = rival(plain, elbow, 0.2, tied=True)
    assert _one_each([rivals[0], tied, rivals[2]]) == [tied, rivals[2]]


def test_table_says_which_effects_of_a_drive_the_corrected_model_holds():
    spec = mujoco.MjSpec.from_string(PENDULUM)
    ctx = nominal_context(compile_variable(spec))
    motor = Place("actuator", "motor", 0)
    gain, gap = Term("actuator_gain", motor), Term("actuator_deadzone", motor)
    h = Hypothesis.of(gain, gap)
    f = Fitted(h, h.gather(ctx, {gain: np.array([0.7]), gap: np.array([0.1])}), np.zeros(2))
    rows = [
        {"id": t.id, "form": t.id, "at": "motor", "kind": "actuator", "parameters": {}} for t in (gain, gap)
    ]
    nothing = Fitted(Hypothesis(), np.zeros(0), np.zeros(0))
    d = SimpleNamespace(
        prepared=SimpleNamespace(spec=spec),
        fit=nothing,
        ctx=ctx,
        terms=(),
        actuators=ActuatorSide(ctx, [f], table=rows),
    )
    table = effects_table(d)
    assert table["model"] == "nominal.xml"
    assert {e["id"]: e["native"] for e in table["effects"]} == {
        "actuator_gain": True,
        "actuator_deadzone": False,
    }
    assert corrected_spec(d)[0].compile().actuator_gainprm[0, 0] == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"value": 0.7012, "low": 0.66, "high": 0.74, "unit": "N m"}, "0.70 N m"),
        ({"value": 3.1e-11, "low": -1.0, "high": 1.0, "unit": "N m"}, "0 N m"),
        (
            {
                "value": [3.1e-11, 0.05, -0.2],
                "low": [-0.3, 0.04, -0.21],
                "high": [0.3, 0.06, -0.19],
                "unit": "m",
            },
            "(0, 0.050, -0.20) m",
        ),
        (
            {"value": [3.1e-11, 0.05], "low": [None, 0.04], "high": [None, 0.06], "unit": "m"},
            "(0, 0.050) m",
        ),
        ({"value": None, "low": None, "high": None, "unit": "m"}, "unknown m"),
    ],
)
def test_quantities_show_digits_that_mean_something(entry, text):
    assert quantity(entry) == text
