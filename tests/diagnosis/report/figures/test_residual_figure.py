"""Functions are drawn over the ranges of their inputs, with points where they were seen."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.report import html_sections
from mpge_jax.diagnosis.report.figures import residual_figure
from mpge_jax.diagnosis.report.sentences import of_inputs
from mpge_jax.diagnosis.residual.model import Function, ResidualModel
from mpge_jax.diagnosis.residual.points import Points
from tests.diagnosis.machines import PENDULUM
from tests.diagnosis.searches import HINGE

SPEED, ANGLE = Axis("v", -4.0, 4.0), Axis("q", -1.0, 1.0)


def law(*axes, said=None):
    """A function that is 0.5 of the first input."""
    rng, effect = np.random.default_rng(0), Residual(axes, 4.0)
    x = [rng.uniform(a.low, a.high, 500) for a in axes]
    theta = np.linalg.lstsq(np.array(effect.basis(np, x)).T, 0.5 * x[0], rcond=None)[0]
    return Function(Term(effect.id, HINGE), theta, said)


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Gives the figure of functions with points, of which the first inputs are -2, 1 and 3."""
    seen = [np.array([-2.0, 1.0, 3.0]), np.array([0.5, -0.5, 0.0])]

    def points(_prepared, _fit, function):
        return Points(np.array([-1.1, 0.4, 1.6]), tuple(seen[: len(function.axes)]))

    monkeypatch.setattr(residual_figure, "missing_in_motion", points)
    figures = []
    save = residual_figure.drawing.save
    monkeypatch.setattr(residual_figure.drawing, "save", lambda f, path: figures.append(f) or save(f, path))
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))

    def draw(*functions):
        d = SimpleNamespace(ctx=ctx, prepared=None, fit=None, held=None)
        assert residual_figure.residual(d, functions, tmp_path / "residual.png").stat().st_size > 1000
        return figures[-1]

    return draw


def test_a_function_of_one_input_is_a_curve_through_points(drawn):
    (ax,) = drawn(law(SPEED)).axes
    points, curve = ax.lines
    np.testing.assert_allclose(points.get_xydata(), [[-2, -1.1], [1, 0.4], [3, 1.6]])
    x, y = curve.get_xydata().T
    assert (x[0], x[-1]) == (-4.0, 4.0)
    np.testing.assert_allclose(y, 0.5 * x, atol=1e-6)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("speed (rad/s)", "hinge (N m)")


def test_points_stand_within_the_part_of_a_turn_that_repeats(drawn):
    sixth = Axis.within_turn(6)
    function = Function(Term(Residual((sixth,), 4.0).id, HINGE), np.zeros(9), None)
    (ax,) = drawn(function).axes
    part = np.pi / 3
    np.testing.assert_allclose(ax.lines[0].get_xdata(), [2 * part - 2, 1, 3 - 2 * part])
    assert ax.get_xlabel() == "angle within 1/6 of a turn (rad)"
    (whole,) = drawn(Function(Term(Residual((Axis.within_turn(),), 4.0).id, HINGE), np.zeros(9), None)).axes
    assert whole.get_xlabel() == "angle within a turn (rad)"


def test_a_function_of_two_inputs_is_a_map_beside_what_it_says_of_the_points(drawn):
    axes = drawn(law(SPEED, ANGLE), law(SPEED)).axes
    assert len(axes) == 4
    left, right = (
        next(ax for ax in axes if ax.get_xlabel() == x) for x in ("speed (rad/s)", "as the function says")
    )
    mesh, dots = left.collections
    np.testing.assert_allclose(mesh.get_array()[0], np.linspace(-2, 2, residual_figure.GRID), atol=1e-6)
    np.testing.assert_allclose(dots.get_offsets(), [[-2, 0.5], [1, -0.5], [3, 0.0]])
    # dots have the colour of the map where the function is right
    np.testing.assert_allclose(dots.get_array(), [-1.1, 0.4, 1.6])
    assert mesh.get_clim() == dots.get_clim() and mesh.get_clim()[0] == -mesh.get_clim()[1]
    np.testing.assert_allclose(right.lines[1].get_xydata(), [[-1, -1.1], [0.5, 0.4], [1.5, 1.6]], atol=1e-6)
    assert left.get_ylabel() == "position (rad)"


def test_functions_are_drawn_where_no_held_out_piece_shows_anything(drawn, monkeypatch):
    nothing = np.zeros(0)
    monkeypatch.setattr(
        residual_figure,
        "missing_in_motion",
        lambda _p, _f, function: Points(nothing, (nothing,) * len(function.axes)),
    )
    axes = drawn(law(SPEED), law(SPEED, ANGLE)).axes
    assert len(axes) == 4 and all(np.isfinite(ax.get_ylim()).all() for ax in axes)


def test_inputs_are_told_with_the_letters_of_the_formula():
    plain, lettered = law(SPEED, ANGLE), law(SPEED, ANGLE, said="about 0.5 v N m, for -4 < v < 4 rad/s")
    assert of_inputs(plain) == "of the speed of the joint and the position of the joint"
    assert of_inputs(lettered) == (
        "of the speed v of the joint and the position q of the joint (about 0.5 v N m, for -4 < v < 4 rad/s)"
    )


def test_the_page_says_what_it_is_and_what_it_does(tmp_path, monkeypatch):
    monkeypatch.setattr(html_sections, "error_unit", lambda _: "rad")
    picture = tmp_path / "residual.png"
    picture.write_bytes(b"\x89PNG")
    function = law(SPEED, said="about 0.5 v N m, for -4 < v < 4 rad/s")
    d = SimpleNamespace(residual=ResidualModel((function,), 0.08, 0.02))
    text = html_sections.residual(d, {"residual": picture})
    assert "falls from 0.08 to 0.02 rad, 4 times smaller" in text
    assert (
        "A force at the hinge, as a function of the speed v of the joint (about 0.5 v N m, for -4 &lt; v &lt; 4 rad/s)."
        in text
    )
    assert html_sections.residual(SimpleNamespace(residual=None), {}) == ""
