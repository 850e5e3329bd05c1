"""What people read: one rival an effect and place, numbers without noise digits."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.corrected.mjcf import corrected_spec
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.intervals import parameters
from mpge_jax.diagnosis.estimation.quantities import intervals, quantity
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.report import sentences
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.motion_figures import span
from mpge_jax.diagnosis.report.html_page import _drives
from mpge_jax.diagnosis.report.html_sections import changes, pasted
from mpge_jax.diagnosis.report.markdown_page import window_errors
from mpge_jax.diagnosis.report.sentences import explanation
from mpge_jax.diagnosis.report.tables import effects_table
from mpge_jax.diagnosis.selection.alternatives import _one_each
from mpge_jax.diagnosis.verdict.result import ties_of
from tests.diagnosis.machines import ARM, PENDULUM


def test_forms_of_a_rival_are_one_entry_and_ties_win():
    elbow, wrist = Place("joint", "elbow", 0), Place("joint", "wrist", 1)

    def rival(name: str, place: Place, margin: float, tied: bool = False) -> Rival:
        return Rival(Term(name, place), NOTHING, margin, "", tied)

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
    d = SimpleNamespace(
        prepared=SimpleNamespace(spec=spec),
        fit=NOTHING,
        residual=None,
        ctx=ctx,
        terms=(),
        actuators=ActuatorSide(ctx, [f]),
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


def test_intervals_show_as_many_digits_as_they_mean():
    assert intervals({"low": 0.098071, "high": 0.103099, "unit": "N m"}) == "0.098 to 0.103 N m"
    assert intervals({"low": [0.1, None], "high": [0.2, None], "unit": "1"}) == "0.10 to 0.20"
    assert intervals({"low": None, "high": None, "unit": "1"}) == "not determined"


def test_components_of_which_nothing_is_known_are_not_called_nothing():
    entry = {"value": [-0.5018, -4.7e-10, -0.6947], "low": [-0.5108, -356.6, -0.7039], "unit": "N"}
    assert quantity({**entry, "high": [-0.4928, 356.6, -0.6854]}) == "(-0.502, unknown, -0.695) N"
    assert (
        quantity({**entry, "low": [-0.51, -0.02, -0.71], "high": [-0.49, 0.02, -0.68]})
        == "(-0.50, 0, -0.69) N"
    )


@pytest.mark.parametrize(
    ("effect", "theta"), [("joint_stiffness", [0.4, -0.6]), ("cogging_torque", [0.5, 0.5, 3.0])]
)
def test_limits_of_what_is_fitted_are_none_of_what_is_reported(effect, theta):
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    ctx = replace(ctx, torque=np.full(1, 0.005))
    term = Term(effect, REGISTRY[effect].places(ctx)[0])
    theta = np.array(theta)[: len(term.params(ctx))]
    f = Fitted(Hypothesis.of(term), theta, theta, cov=1e-4 * np.eye(theta.size))
    for entry in parameters(ctx, f, term).values():
        assert entry["low"] <= entry["value"] <= entry["high"]


@pytest.mark.parametrize(
    ("effect", "theta", "at_zero"),
    [
        ("stribeck_friction", [0.02, 0.03, 0.3], ["coulomb"]),
        ("load_dependent_friction:falling", [0.0, 0.02, 0.3, 0.3], ["coulomb", "load_coefficient"]),
    ],
)
def test_limits_hold_of_what_is_reported_as_it_is_fitted(effect, theta, at_zero):
    """Friction and speeds are no less than nothing, though a law reports others of its parameters otherwise."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    term = Term(effect, REGISTRY[effect].places(ctx)[0])
    f = Fitted(Hypothesis.of(term), np.array(theta), np.array(theta), cov=np.eye(len(theta)))
    reported = parameters(ctx, f, term)
    assert all(reported[name]["low"] == 0.0 < reported[name]["high"] for name in at_zero)
    assert 0.0 < reported["velocity"]["low"] < 0.3
    # and are not called nothing where the interval holds no zero
    assert quantity(reported["velocity"]) == "0.30 rad/s"
    assert quantity({"value": 0.005, "low": 0.005, "high": 0.52, "unit": "rad/s"}) == "0.0050 rad/s"


def test_errors_of_drives_are_in_the_report_with_escaped_names():
    d = SimpleNamespace(actuators=SimpleNamespace(errors={"<b>": (0.25, 0.0125)}))
    text = _drives(d)
    assert "&lt;b&gt;" in text and "<td>0.25</td><td>0.0125</td>" in text
    assert _drives(SimpleNamespace(actuators=None)) == ""


def test_candidates_are_told_in_one_sentence():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    friction = Term("coulomb_friction", Place("joint", "hinge", 0))
    bias = Term("actuator_bias", Place("actuator", "motor", 0))
    fits = [
        Fitted(Hypothesis.of(t), np.array([0.05]), np.zeros(1), np.array([[1e-8]])) for t in (friction, bias)
    ]
    payload = Term("payload_mass", Place("body", "arm", 1))
    rival = Rival(bias, fits[1], 0.0, "", True)
    errors = SimpleNamespace(rms=0.1, window=np.full(3, 0.1))
    d = SimpleNamespace(
        terms=(friction,), fit=fits[0], rivals={friction: [rival]}, ctx=ctx, actuators=None, unexplained=None,
        remainder=0.0, residual=None, doubtful=(), given_inertias=None, error_drop={friction: 0.9, payload: 0.5},
        prepared=SimpleNamespace(
            model=ctx.model, measured=np.zeros(1, bool), train=()
        ),
        held=SimpleNamespace(
            before=errors, after=errors, floor=0.1, floors=np.full(3, 0.1),
            windows=SimpleNamespace(times=np.array([0.5])),
        ),
    )  # fmt: skip
    first = explanation(d).partition(". ")[0]
    assert first == (
        "The recordings cannot tell which: the hinge has dry friction of 0.05000 N m that the model lacks, or "
        "the actuator motor adds a constant 0.05000 N m to what it is told"
    )
    # a name is written as in the model, but at the beginning of a sentence
    heavy = Fitted(Hypothesis.of(payload), np.full(4, 0.5), np.zeros(4), 1e-8 * np.eye(4))
    d.rivals = {friction: [Rival(payload, heavy, 0.0, "", True)]}
    assert "lacks, or arm carries" in explanation(d)
    d.terms, d.fit, d.rivals = (payload,), heavy, {}
    assert explanation(d).startswith("Arm carries")
    # what takes more of the error away comes first
    both = Hypothesis.of(payload, friction)
    d.terms = both.terms
    d.fit = Fitted(both, np.append(np.full(4, 0.5), 0.05), np.zeros(5), 1e-8 * np.eye(5))
    assert explanation(d).startswith("The hinge has dry friction")
    d.error_drop = {friction: np.nan, payload: 0.5}
    assert explanation(d).startswith("Arm carries")
    # how far a remainder is beyond noise is said where it is far
    d.remainder = 0.017
    assert "1.7 % of the squared error is more than noise; it is too slight" in explanation(d)
    d.held.after, d.held.floor = SimpleNamespace(rms=0.2, window=np.full(3, 0.2)), 0.01
    assert "more than noise (the error is 20 times what noise alone leaves); it is too" in explanation(d)
    # a share of the error is said where something is explained
    d.remainder, d.unexplained = 0.0, {"at": ["hinge"], "when": "always", "share": 0.3, "of": "motion"}
    assert "Beyond that, something acts at the hinge" in explanation(d) and "makes up 30 %" in explanation(d)
    assert "may be a part of the same" not in explanation(d)
    d.doubtful = (friction, payload)
    assert (
        explanation(d)
        .partition("predicts. ")[2]
        .startswith(
            "What was named there may be a part of the same: too much is left beside coulomb friction at hinge and "
            "payload mass at arm to be sure of them."
        )
    )
    d.doubtful = ()
    d.terms, d.fit = (), NOTHING
    assert explanation(d) == "Something acts at the hinge that no known effect explains: always."


def test_window_errors_leave_out_what_was_not_measured():
    curves = np.full((3, 2, 3), np.nan)
    curves[:, :, 0] = [[3.0, 4.0], [1.0, 1.0], [2.0, 2.0]]
    curves[:2, 0, 1] = [5.0, 7.0]
    report = SimpleNamespace(before=SimpleNamespace(curves=curves), after=None)
    np.testing.assert_allclose(window_errors(report, after=False), [2.0, 6.0, np.nan])


def test_components_of_a_vector_have_hardly_more_decimals_than_the_largest():
    entry = {"value": [-8.3e-05, -2.2e-05, 0.0613], "unit": "m"}
    entry |= {k: [v + s for v in entry["value"]] for k, s in (("low", -1e-6), ("high", 1e-6))}
    assert quantity(entry) == "(-0.000083, -0.000022, 0.06130) m"
    wide = {k: [v + s for v in entry["value"]] for k, s in (("low", -1e-3), ("high", 1e-3))}
    assert quantity({**entry, **wide}) == "(-0.0001, 0, 0.061) m"


def test_changed_lines_of_a_model_are_shown():
    before = '<a>\n  <joint name="x"/>\n</a>'
    after = before.replace("/>", ' damping="2"/>')
    assert changes(before, after) == ['-  <joint name="x"/>', '+  <joint name="x" damping="2"/>']
    assert "&lt;joint name=&quot;x&quot; damping=&quot;2&quot;/&gt;" in pasted(before, after)
    assert pasted(before, before) == ""


def test_curves_fill_their_panels_and_what_runs_away_leaves_them():
    measured = np.linspace(0.0, 1.0, 50)
    low, high = span(measured, (measured + 0.1, 0.99 * measured), 0.0)
    assert high - low < 1.3 and low < 0.0 and high > 1.1
    assert span(measured, (10.0 * measured,), 0.0)[1] < 2.3


def test_the_shortest_bar_is_seen_too(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(drawing, "save", lambda figure, path: figures.append(figure))
    drawing.bars(["a", "b"], np.array([3.1e-3, 3.2e-3]), np.array([3e-3, np.nan]), 3.05e-3, "error", tmp_path)
    low, high = figures[0].axes[0].get_xlim()
    assert low < 0.7 * 3e-3 and high > 3.2e-3


def test_an_effect_of_many_joints_is_told_in_one_sentence():
    links = "".join(
        f'<body name="b{k}" pos="0 0 -.2"><joint name="j{k}" axis="0 1 0"/><geom size=".05" mass="1"/>'
        for k in range(3)
    )
    xml = f"<mujoco><worldbody>{links}{'</body>' * 3}</worldbody></mujoco>"
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    damped = [Term("viscous_damping", Place("joint", f"j{k}", k)) for k in range(3)]
    fit = Fitted(Hypothesis.of(*damped), np.array([1.0, 2.0, 3.0]), np.zeros(3), cov=1e-8 * np.eye(3))
    d = SimpleNamespace(ctx=ctx, fit=fit, terms=fit.hypothesis.terms)
    told = sentences._alike(damped, d)
    assert set(told) == set(damped) and sentences._alike(damped[:2], d) == {}
    assert sentences._said_together(d, told[damped[0]]) == (
        "Viscous damping that the model lacks: 1.000 N m s/rad at j0, 2.000 N m s/rad at j1 and 3.000 N m s/rad at j2."
    )


def test_what_ties_only_all_together_is_one_question():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(ARM)))
    joints = [Place("joint", name, i) for i, name in enumerate(("shoulder", "elbow"))]
    motors = [Place("actuator", name, i) for i, name in enumerate(("shoulder_motor", "elbow_servo"))]
    sensors = [Term("sensor_delay", j) for j in joints]
    drives = [Term("actuator_delay", a) for a in motors]

    def late(terms: list[Term]) -> Fitted:
        return Fitted(Hypothesis.of(*terms), np.full(2, 0.03), np.zeros(2), 1e-8 * np.eye(2))

    # fitted for each of them
    rivals = {t: [Rival(drives[i], late(drives), 0.0, "", True)] for i, t in enumerate(sensors)}
    d = SimpleNamespace(
        ctx=ctx,
        fit=late(sensors),
        terms=tuple(sensors),
        rivals=rivals,
        error_drop=dict.fromkeys(sensors, 1.0),
    )
    ((terms, fits),) = ties_of(d)
    assert terms == tuple(sensors) and len(fits) == 2
    ((_, text),) = sentences._of_effects(d)
    assert text == (
        "The recordings cannot tell which: sensor delay of 0.03000 s at shoulder and 0.03000 s at elbow together, or "
        "actuator delay of 0.03000 s at shoulder_motor and 0.03000 s at elbow_servo together."
    )
    assert "second" in sentences.separation(d, terms, fits)
    # each with a rival of its own is a question of its own
    d.rivals = {
        t: [Rival(drives[i], late([sensors[1 - i], drives[i]]), 0.0, "", True)] for i, t in enumerate(sensors)
    }
    assert [terms for terms, _ in ties_of(d)] == [(t,) for t in sensors]
