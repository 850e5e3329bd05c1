"""Effects that act where something is left that has no name: whether they may be a part of it."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.prediction_error import Errors, errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.residual.model import Function, ResidualModel, with_function
from mpge_jax.diagnosis.thresholds import SLIGHT
from mpge_jax.diagnosis.verdict import judgement
from mpge_jax.diagnosis.verdict.part_of_unknown import Beside, doubtful, left_beside, left_there, matters
from tests.diagnosis.machines import ARM, FLYER, record
from tests.diagnosis.searches import look_for_nothing_beside

MODEL = mujoco.MjModel.from_xml_string(ARM)
P = SimpleNamespace(model=MODEL, names=names_of(MODEL))
SHOULDER, ELBOW = Place("joint", "shoulder", 0), Place("joint", "elbow", 1)
SERVO, FORE = Place("actuator", "elbow_servo", 1), Place("body", "fore", 2)
RUBS, GAIN = Term("coulomb_friction", ELBOW), Term("actuator_gain", SERVO)
PAYLOAD, SPRING = Term("payload_mass", FORE), Term("joint_stiffness", SHOULDER)
WITHOUT = {
    RUBS: np.array([0.1, 1.0]), GAIN: np.array([0.1, 5.0]), PAYLOAD: np.array([9.0, 0.2]),
    SPRING: np.array([4.0, 0.5]),
}  # fmt: skip
AFTER, EACH = np.array([0.1, 0.5]), [[0], [1]]


def test_what_is_left_counts_there_and_where_an_effect_acts():
    shares = left_beside(P, ["elbow"], AFTER, WITHOUT, 0.1, EACH)
    # at the elbow 0.5^2 - 0.1^2 = 0.24 is left, of 0.99, of 24.99 and of 0.03; the spring acts at the shoulder alone
    assert {t: x.there for t, x in shares.items()} == pytest.approx(
        {RUBS: 0.24 / 0.99, GAIN: 0.24 / 24.99, PAYLOAD: 0.24 / 0.03}
    )
    # the payload moves the shoulder too, where it explains far more: of 80.99 + 0.03
    assert {t: x.own for t, x in shares.items()} == pytest.approx(
        {RUBS: 0.24 / 0.99, GAIN: 0.24 / 24.99, PAYLOAD: 0.24 / 81.02}
    )
    assert left_beside(P, ["elbow_servo"], AFTER, WITHOUT, 0.1, EACH) == shares
    # what corrects the given masses is nothing that is named
    assert (
        left_beside(P, ["elbow"], AFTER, {**WITHOUT, given_inertias(0.03): np.full(2, 0.6)}, 0.1, EACH)
        == shares
    )
    # what noise leaves of each error, and errors that nobody measured
    floors, unseen = np.array([0.1, 0.5]), np.array([0.1, np.nan])
    assert left_beside(P, ["elbow"], AFTER, WITHOUT, floors, EACH)[RUBS] == Beside(0.0, 0.0)
    assert left_beside(P, ["elbow"], unseen, WITHOUT, 0.1, EACH)[RUBS] == Beside(0.0, 0.0)
    both = left_beside(P, ["elbow", "shoulder"], AFTER, WITHOUT, 0.0, EACH)
    assert len(both) == 4
    assert (both[SPRING].there, both[SPRING].own) == pytest.approx((0.26 / 16.25, 0.01 / 16.0))


def test_a_floating_base_goes_by_its_body():
    m = mujoco.MjModel.from_xml_string(FLYER)
    p, drag = SimpleNamespace(model=m, names=names_of(m)), Term("quadratic_drag", Place("body", "frame", 1))
    shares = left_beside(p, ["frame"], np.full(6, 0.1), {drag: np.full(6, 0.2)}, 0.0, [[0]] * 6)
    assert (shares[drag].there, shares[drag].own) == pytest.approx((0.25, 0.25))


def test_what_is_left_is_a_detail_only_beside_all_that_acts_there():
    slight = Beside(0.001, 0.7)
    assert matters(0.03, {}) and not matters(0.01, {RUBS: Beside(0.015, 0.8), GAIN: slight})
    assert matters(0.001, {RUBS: Beside(0.5, 0.0), GAIN: slight})


def test_effects_are_in_doubt_where_more_than_a_detail_is_left_beside_them():
    assert doubtful({RUBS: Beside(0.3, 0.3), GAIN: Beside(0.3, 0.01), PAYLOAD: Beside(0.1, 7.0)}, None) == (
        RUBS,
        PAYLOAD,
    )
    shoulder = Term("back_emf", Place("actuator", "shoulder_motor", 0))
    drives = SimpleNamespace(left=[{"at": ["elbow_servo"]}], drops={GAIN: 0.9, shoulder: 0.5})
    assert doubtful({}, drives) == (GAIN,)
    drives.drops[GAIN] = 0.999
    assert doubtful({}, drives) == ()


SPEED = Residual((Axis("v", -9.0, 9.0),), 9.0)
BRAKES = Function(Term(SPEED.id, ELBOW), -0.2 * np.linspace(-9, 9, 9), None)


@pytest.fixture(scope="module")
def rubs_otherwise(plain_functions):
    """A spring at the shoulder, and damping at the elbow that depends on the angle."""

    def force(m: mujoco.MjModel, d: mujoco.MjData) -> None:
        d.qfrc_applied[0] = -30.0 * d.qpos[0]
        d.qfrc_applied[1] = -0.15 * d.qvel[1] * (1.0 + 1.5 * np.sin(3.0 * d.qpos[1]))

    effects = ("viscous_damping", "joint_stiffness")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(judgement, "residual_of_motion", lambda *_: ResidualModel((BRAKES,), 0.2, 0.1))
        look_for_nothing_beside(patched)
        # nobody fitted that function beside the damping
        patched.setattr(judgement, "without_needless", lambda _p, _s, found, _at, its, *_: (found, its))
        recordings = record(ARM, [4.0, 0.8], force=force, seconds=3.0)
        return diagnose(mujoco.MjSpec.from_string(ARM), recordings, Config(effects=effects, jobs=1))


def test_a_detail_of_all_errors_may_be_much_beside_one_effect(rubs_otherwise):
    d, table = rubs_otherwise, rubs_otherwise.to_json()
    assert (d.verdict, d.unexplained["at"]) == ("unexplained", ["elbow"])
    # of the squared error of all joints a detail, and more than that of the elbow's
    assert d.held.left(rugged=False) ** 2 < 0.02 < d.unexplained["share"] < 0.1
    assert "of the squared error of the motion there that the model as given predicts" in table["explanation"]
    assert {(e["id"], e["at"]) for e in table["effects"]} == {
        ("joint_stiffness", "shoulder"),
        ("viscous_damping", "elbow"),
    }
    # the spring explains far more than is left, and acts elsewhere
    assert [str(t) for t in d.doubtful] == ["viscous_damping@elbow"]


def test_what_goes_with_an_effect_goes_beside_what_stands_for_the_rest(rubs_otherwise):
    d = rubs_otherwise
    p, both = d.prepared, with_function(d.ctx, d.fit, BRAKES.term, BRAKES.theta)
    (damping,) = d.doubtful
    fewer = both.of_terms(d.ctx, both.hypothesis.without(damping))
    with_it, without = (errors(p.sim, f, d.held.windows, p.noise, near=both).rms for f in (both, fewer))
    assert d.error_drop[damping] == pytest.approx(1.0 - with_it**2 / without**2)


def test_doubt_is_told_in_the_table_and_in_words(rubs_otherwise):
    table = rubs_otherwise.to_json()
    (group,) = table["ambiguous"]
    (named,), unknown = group["candidates"]
    assert (named["id"], named["at"]) == ("viscous_damping", "elbow") and named["parameters"]["coefficient"]
    assert unknown == [{"id": "unexplained", "at": "elbow", "parameters": {}}]
    assert (
        group["separated_by"].startswith("move elbow alone, slowly and fast") and group["experiment"] is None
    )
    assert (
        "What was named there may be a part of the same: too much is left beside viscous damping at elbow to be"
        in (table["explanation"])
    )


def _report(
    before: list[float], after: list[float], floor: float = 0.1, joints: float | None = None
) -> FitReport:
    each = (
        Errors(float(np.sqrt(np.mean(np.square(x)))), np.array(x), np.ones(1), np.ones((1, 1, 2)))
        for x in (before, after)
    )
    return FitReport(None, *each, np.full(1, floor), floor, np.full(2, joints or floor), np.full(2, np.inf))


def test_what_is_left_at_its_joint_counts_by_what_was_missed_there():
    """The shoulder's error falls from 20 to 0.1; of the elbow's 0.8 nothing goes: a detail of both, and none there."""
    report = _report([20.0, 0.8], [0.1, 0.7])
    assert report.left(rugged=False) ** 2 < SLIGHT
    assert left_there(P, ["elbow"], report, False) == pytest.approx((0.49 - 0.01) / (0.64 - 0.01))
    assert left_there(P, ["shoulder"], report, False) == 0.0
    assert left_there(P, ["shoulder", "elbow"], report, False) == left_there(P, ["elbow"], report, False)
    # noise may leave that, and impacts do
    assert left_there(P, ["elbow"], _report([20.0, 0.8], [0.1, 0.19]), False) == 0.0
    assert left_there(P, ["elbow"], report, True) == 0.0
    # by its own noise: that of other joints may be larger
    own = _report([20.0, 0.8], [0.1, 0.19], joints=0.05)
    assert left_there(P, ["elbow"], own, False) == pytest.approx((0.19**2 - 0.05**2) / (0.64 - 0.05**2))
    assert left_there(P, ["elbow"], _report([20.0, 0.8], [0.1, 0.9]), False) == 1.0
    assert left_there(P, ["elbow"], _report([20.0, np.nan], [0.1, np.nan]), False) == 0.0
