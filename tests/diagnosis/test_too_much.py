"""A model may have too much of what a machine has less of: damping, dry friction, rotor inertia, a spring."""

import json

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.selection.closer_forms import _forms
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import fitted, search_of

GIVEN = (
    ARM.replace('damping="0.05" armature="0.01"', 'damping="0.05" armature="0.05" frictionloss="0.2"')
    .replace('damping="0.03"', 'damping="0.03" stiffness="2" springref="0.3"')
    .replace('joint="shoulder"/>', 'joint="shoulder" gear="2"/>')
)
ACTS = {
    "viscous_damping@elbow": (-0.25, "The model damps the elbow by 0.2"),
    "coulomb_friction@shoulder": (-0.12, "The model has 0.1"),
    "armature@shoulder": (-0.03, "The model has 0.0"),
    "joint_stiffness@elbow": (-1.2, "The model's spring at the elbow is too stiff by 1."),
}


def _less(model: mujoco.MjModel) -> None:
    # of the servo's braking, as of the joint's own
    model.actuator_biasprm[1, 2] += 0.25
    model.dof_frictionloss[0] -= 0.12
    model.dof_armature[0] -= 0.03
    model.jnt_stiffness[1] -= 1.2


def test_what_the_model_has_too_much_of_is_named_with_its_size(tmp_path):
    config = Config(jobs=1, quiet=True, effects=tuple({x.partition("@")[0] for x in ACTS}))
    d = diagnose(mujoco.MjSpec.from_string(GIVEN), record(GIVEN, [2.0, 1.0], change=_less), config)
    d.write(tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert table["verdict"] == "effects" and {f"{e['id']}@{e['at']}" for e in table["effects"]} == set(ACTS)
    for effect in table["effects"]:
        size, says = ACTS[f"{effect['id']}@{effect['at']}"]
        first = next(iter(effect["parameters"].values()))
        assert first["value"] == pytest.approx(size, rel=0.05) and first["low"] <= size <= first["high"]
        assert says in table["explanation"]
    assert "lacks" not in table["explanation"]
    corrected = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    truth = mujoco.MjModel.from_xml_string(GIVEN)
    _less(truth)
    for field in ("dof_frictionloss", "dof_armature", "jnt_stiffness"):
        np.testing.assert_allclose(getattr(corrected, field), getattr(truth, field), rtol=0.05, atol=1e-9)
    # no joint pushes by itself: what is beyond its own damping its servo brakes less
    assert corrected.dof_damping[1] == 0.0
    damping = [m.dof_damping[1] - m.actuator_biasprm[1, 2] for m in (corrected, truth)]
    assert damping[0] == pytest.approx(damping[1], rel=0.05)


def test_there_is_too_much_of_what_the_model_has_and_no_more():
    """Bounds by hand: the servo brakes the elbow with 0.4 beside its own 0.03; a gear counts twice."""
    geared = GIVEN.replace('kv="0.4"', 'kv="0.4" gear="3"')
    for xml, name, most in (
        (GIVEN, "viscous_damping@elbow", 0.43),
        (geared, "viscous_damping@elbow", 0.03 + 9 * 0.4),
        (GIVEN, "viscous_damping@shoulder", 0.05),
        (GIVEN, "coulomb_friction@shoulder", 0.2),
        (GIVEN, "coulomb_friction@elbow", 0.0),
        (GIVEN, "armature@shoulder", 0.05),
        (GIVEN, "joint_stiffness@elbow", 0.999 * 2),
    ):
        ctx = nominal_context(mujoco.MjModel.from_xml_string(xml))
        effect, _, at = name.partition("@")
        place = next(p for p in REGISTRY[effect].places(ctx) if p.name == at)
        assert REGISTRY[effect].params(ctx, place)[0].low == pytest.approx(-most)


def test_what_there_is_too_much_of_has_no_closer_form():
    s, _ = search_of(GIVEN, record(GIVEN, [2.0, 1.0], count=4, seconds=1.0))
    term = next(t for t in s.terms if str(t) == "coulomb_friction@shoulder")
    assert not _forms(s, fitted(s, {term: [-0.05]}), 1)
    (form,) = _forms(s, fitted(s, {term: [0.05]}), 1).values()
    assert form == Term("coulomb_friction:elastic", term.place)
    assert form.params(s.sim.ctx)[0].low > 0.0
