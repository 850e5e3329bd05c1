"""Where the model as given lacks force: joints, and what acts on them."""

from types import SimpleNamespace

import mujoco
import pytest

from mpge_jax.diagnosis import REGISTRY, Config
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.verdict.location import locate
from tests.diagnosis.machines import ARM, ROTORS, record


def _located(*terms, joints, rivals=(), actuators=None):
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    ctx = nominal_context(model)
    term = [Term(i, find_place(ctx, REGISTRY[i], at)) for i, at in terms]
    tied = [Term(i, find_place(ctx, REGISTRY[i], at)) for i, at in rivals]

    def fit(*x):
        return SimpleNamespace(hypothesis=Hypothesis.of(*x))

    return locate(
        SimpleNamespace(
            prepared=SimpleNamespace(model=model, names=names_of(model), train=()),
            terms=tuple(term),
            fit=fit(*term),
            rivals={term[0]: [SimpleNamespace(tied=True, term=t, fit=fit(t)) for t in tied]} if tied else {},
            location=[(name, "joint", ratio) for name, ratio in joints],
            actuators=actuators,
            unexplained=None,
        )
    )


def test_bodies_actuators_and_the_world_are_located_by_the_joints_on_which_they_act():
    joints = [("elbow", 40.0), ("shoulder", 9.0)]
    assert _located(("coulomb_friction", "elbow"), joints=joints) == [
        ("elbow", "joint", 40.0),
        ("shoulder", "joint", 9.0),
    ]
    assert _located(("actuator_gain", "shoulder_motor"), joints=joints) == [
        ("elbow", "joint", 40.0),
        ("shoulder_motor", "actuator", 9.0),
        ("shoulder", "joint", 9.0),
    ]
    assert _located(("payload_mass", "fore"), joints=joints)[0] == ("fore", "body", 40.0)
    assert _located(("payload_mass", "upper"), joints=joints)[1] == ("upper", "body", 9.0)
    assert _located(("mass_scale", "world"), joints=joints)[0] == ("world", "world", 40.0)
    both = _located(("coulomb_friction", "elbow"), joints=joints, rivals=[("actuator_gain", "elbow_servo")])
    assert both[:2] == [("elbow", "joint", 40.0), ("elbow_servo", "actuator", 40.0)]
    drives = SimpleNamespace(excess={"elbow_servo": 36.0, "shoulder_motor": 1.0})
    located = _located(joints=joints, actuators=drives)
    assert located[1] == ("elbow_servo", "actuator", pytest.approx(36.0))
    assert located[-1] == ("shoulder_motor", "actuator", pytest.approx(1.0))


def test_a_geom_goes_by_its_body():
    names = names_of(compile_variable(mujoco.MjSpec.from_string(ARM)))
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    term = Term("contact_friction", Place("geom", names.geoms[1], 1))
    d = SimpleNamespace(
        prepared=SimpleNamespace(model=model, names=names, train=()),
        terms=(term,),
        fit=None,
        rivals={},
        location=[("elbow", "joint", 3.0)],
        actuators=None,
        unexplained=None,
    )
    assert locate(d) == [("fore", "body", 3.0), ("elbow", "joint", 3.0)]


def test_a_floating_base_is_located_by_its_body():
    """Wind on the base of a planar drone with an arm: the base misses force, and so does what hangs on it."""
    arm = '<body name="arm"><joint name="swing" axis="0 1 0" damping=".02"/>'
    arm += '<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".2"/></body></body>'
    xml = ROTORS.replace("</body>", arm).replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>')

    def wind(_model, data):
        data.xfrc_applied[1, 0] = 0.5

    recordings = record(xml, 0.05, force=wind, count=3, seconds=1.5)
    prepared = prepare(mujoco.MjSpec.from_string(xml), recordings, Config(jobs=1))
    term = Term("external_force", Place("body", "drone", 1))
    fit = SimpleNamespace(hypothesis=Hypothesis.of(term))
    d = SimpleNamespace(
        prepared=prepared,
        terms=(term,),
        fit=fit,
        rivals={},
        actuators=None,
        unexplained=None,
        location=[("swing", "joint", 1.5)],
    )
    (name, kind, ratio), *others = locate(d)
    assert (name, kind) == ("drone", "body") and ratio > 10.0
    assert others == [("swing", "joint", 1.5)]
