"""The machine at moments of a recording: poses of either model by hand, rendered over the measured one or as lines."""

from types import SimpleNamespace

import matplotlib.image
import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.report.figures import motion_strip, robot_render
from tests.diagnosis.machines import FLYER, PENDULUM

ROWS = 21


def _prepared(xml):
    spec = mujoco.MjSpec.from_string(xml)
    return SimpleNamespace(spec=spec, model=compile_variable(spec))


def _whole(qpos, before, after=None):
    """A recording of one row each 0.1 s from 0.5 s on, and errors of the models [ROWS, nv]."""
    source = SimpleNamespace(recording=SimpleNamespace(shown_origin=10.0))
    windows = SimpleNamespace(
        qpos=qpos[None],
        seen=np.ones((1, ROWS), bool),
        times=0.1 * np.arange(ROWS)[None],
        start=np.array([0.5]),
        sources=(source,),
    )
    errors = [SimpleNamespace(curves=x[None]) for x in (before, *([] if after is None else [after]))]
    return SimpleNamespace(windows=windows, before=errors[0], after=errors[-1])


def test_poses_are_those_that_models_have_at_evenly_spread_moments():
    p, t = _prepared(PENDULUM), np.linspace(0, 1, ROWS)[:, None]
    times, poses = motion_strip.poses(p, _whole(t, 0.5 * t, -0.1 * t))
    np.testing.assert_allclose(times, 10.5 + np.array([0.0, 0.4, 0.8, 1.2, 1.6, 2.0]))
    # what was measured less the error is what a model has
    for pose, factor in zip(np.moveaxis(poses[:, :, 0], 1, 0), (1.0, 0.5, 1.1), strict=True):
        np.testing.assert_allclose(pose, factor * np.linspace(0, 1, 6))
    _, alone = motion_strip.poses(p, _whole(t, 0.5 * t))
    assert alone.shape == (6, 2, 1)


def test_turns_of_a_floating_base_are_taken_off_as_turns():
    p = _prepared(FLYER)
    qpos = np.tile([1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0], (ROWS, 1))
    error = np.tile([0.5, 0.0, 0.0, 0.0, 0.0, 0.6], (ROWS, 1))
    error[-1] = np.inf
    _, poses = motion_strip.poses(p, _whole(qpos, error))
    np.testing.assert_allclose(poses[0, 1], [0.5, 2, 3, np.cos(0.3), 0, 0, -np.sin(0.3)], atol=1e-12)
    # a model that ran away is in no picture
    assert np.isnan(poses[-1, 1]).all() and np.isfinite(poses[-1, 0]).all()


def test_what_was_never_measured_stays_where_the_model_has_it():
    p = _prepared(PENDULUM.replace('axis="0 1 0"', 'axis="0 1 0" ref="17.188733853924695"'))
    nothing = np.full((ROWS, 1), np.nan)
    _, poses = motion_strip.poses(p, _whole(nothing, nothing))
    np.testing.assert_allclose(poses, 0.3)


def _coloured(pixels):
    """Pixels that are rather red, and rather blue."""
    r, _, b = (pixels[..., i].astype(int) for i in range(3))
    return r > b + 50, b > r + 50


def test_models_are_painted_where_they_are_by_then():
    spec = mujoco.MjSpec.from_string(PENDULUM.replace("<geom ", '<geom rgba="1 0 0 1" '))
    frames = np.array([[[0.0], [0.8], [-0.8]], [[0.0], [0.0], [np.nan]]])
    drawn = robot_render.render_frames(spec, frames, motion_strip.GHOSTS)
    if drawn is None:
        pytest.skip("MuJoCo cannot render offscreen here: the rendered frames were not looked at")
    red, blue = (np.nonzero(x[0])[1] for x in _coloured(drawn[..., :3].reshape(1, *drawn.shape)[0]))
    rows = robot_render.FRAME[0]
    # about y, from +z to +x: 0.8 rad is to the one side of what hangs still, -0.8 rad to the other
    middle = np.nonzero((drawn[1] < 240).any(-1))[1].mean()
    assert red.size > 500 and blue.size > 500
    assert (red.mean() - middle) * (blue.mean() - middle) < 0
    assert abs(red.mean() - blue.mean()) > 0.2 * rows
    # grey where it was measured, whatever its colour; of the model that ran away there is nothing
    assert not _coloured(drawn[1])[1].any()
    alone = robot_render.render_frames(spec, frames[:, :1], motion_strip.GHOSTS[:0])
    assert not _coloured(alone[0])[0].any()


def test_the_camera_goes_along_with_a_machine_that_travels():
    spec = mujoco.MjSpec.from_string(FLYER)
    pose = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    frames = np.array([[pose + np.eye(7)[0] * x] * 2 for x in (0.0, 20.0)])
    drawn = robot_render.render_frames(spec, frames, motion_strip.GHOSTS[:1])
    if drawn is None:
        pytest.skip("MuJoCo cannot render offscreen here: the rendered frames were not looked at")
    widths = [np.ptp(np.nonzero((x < 240).any(-1))[1]) for x in drawn]
    assert min(widths) > 0.3 * robot_render.FRAME[0] and widths[0] == pytest.approx(widths[1], rel=0.1)


def test_lines_are_drawn_where_rendering_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(motion_strip, "render_frames", lambda *_: None)
    p, t = _prepared(PENDULUM), np.linspace(0, 1, ROWS)[:, None]
    figures = []
    save = motion_strip.drawing.save
    monkeypatch.setattr(motion_strip.drawing, "save", lambda f, path: figures.append(f) or save(f, path))
    runaway = np.where(t > 0.9, np.inf, 100.0 * t)
    path = motion_strip.strip(p, _whole(t, 0.5 * t, runaway), tmp_path / "strip.png")
    assert matplotlib.image.imread(path).ndim == 3
    axes = figures[0].axes
    assert [ax.get_title() for ax in axes] == [
        "10.50 s",
        "10.90 s",
        "11.30 s",
        "11.70 s",
        "12.10 s",
        "12.50 s",
    ]
    assert [len(ax.lines) for ax in axes] == [3, 3, 3, 3, 3, 2]
    measured, given = (ax.get_xydata() for ax in axes[5].lines)
    # hinge 0.3 m above the end of a link that hangs down at 0 rad
    for ends, angle in ((measured, 1.0), (given, 0.5)):
        np.testing.assert_allclose(np.abs(ends[0] - ends[1]), 0.3 * np.array([np.sin(angle), np.cos(angle)]))


def test_white_around_all_frames_is_cut_away():
    pictures = np.full((2, 60, 80, 3), 255, np.uint8)
    pictures[0, 20, 30] = pictures[1, 40, 50] = 0
    edge = motion_strip.EDGE
    assert motion_strip.cropped(pictures).shape == (2, 21 + 2 * edge, 21 + 2 * edge, 3)
