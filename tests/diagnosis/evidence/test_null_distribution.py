"""What a true model leaves, and when more than that is left."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import Floor, Left, floor
from tests.diagnosis.machines import FINE_PENDULUM, FLYER, PENDULUM, record
from tests.diagnosis.searches import HINGE, fitted, prepared_of


def test_more_is_left_by_the_mean_or_in_several_windows_far_beyond():
    noise = Floor(1.2, 0.05, losses=np.linspace(0.8, 2.0, 32))
    usual, typical, told = np.tile([1.1, 1.3], 30), np.arange(60) < 50, np.full(60, True)
    assert not noise.beyond(Left(usual, typical, told))
    # three standard errors of both means are 0.15
    assert not noise.beyond(Left(usual + 0.14, typical, told)) and noise.beyond(
        Left(usual + 0.18, typical, told)
    )
    few = usual.copy()
    few[-2:] = 6.0
    assert not noise.beyond(Left(few, typical, told))
    few[-3:] = 3.9
    assert not noise.beyond(Left(few, typical, told))
    few[-3:] = 4.1
    assert noise.beyond(Left(few, typical, told))
    # windows of which nothing tells how they begin say nothing
    assert not noise.beyond(Left(few, typical, np.arange(60) < 57))
    # noise alone leaves a loss near one, however little few simulated windows show
    few[-3:] = 1.9
    quiet = Floor(0.9, 0.5, losses=np.full(8, 0.5))
    # of few rows chance leaves more, and without simulated windows nobody knows how many there are
    short = Floor(0.9, 0.5)
    assert not short.beyond(Left(np.where(few > 1.5, 4.9, few), typical, told))
    assert short.beyond(Left(np.where(few > 1.5, 5.1, few), typical, told))
    assert not quiet.beyond(Left(few, typical, told)) and quiet.beyond(
        Left(np.where(few > 1.5, 2.1, few), typical, told)
    )


def test_the_floor_is_what_a_true_model_leaves():
    """The start is smoothed from the same rows as it is compared with, so its error and theirs are not independent."""
    d = diagnose(
        mujoco.MjSpec.from_string(FINE_PENDULUM), record(FINE_PENDULUM, 0.8, noise=1e-3), Config(jobs=1)
    )
    assert d.verdict == "none"
    assert 0.5 < d.held.after.rms / d.held.floor < 1.6


def test_floor_is_lower_than_that_of_independent_errors(null):
    _, p = null
    assert floor(p, NOTHING, p.config.decide_s).ratio < 1.0


def test_the_floor_knows_what_went_before_its_windows():
    """A motor behind a soft spring swings on for half a second: how a window begins, the motion before it tells."""
    xml = PENDULUM.replace('armature="0.004"', 'armature="0.02"')
    losses = []
    # short recordings have nothing before their windows
    for seconds in (4.0, 1.2):
        p = prepared_of(xml, record(xml, 1.0, seconds=seconds))
        f = fitted(p, {Term("joint_flexibility", HINGE): [12.0, 0.3]})
        losses.append(floor(p, f, p.config.decide_s).loss)
    assert 0.7 < losses[0] < 2.0 and losses[1] > 5.0


def test_what_is_left_on_a_free_body_does_not_raise_the_floor():
    """A free body turned by something unknown: noise alone explains none of it."""

    def turn(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[3:6] = 0.05 * np.sin(9.0 * data.time)

    recordings = record(FLYER, 0.05, force=turn, noise=2e-4)
    for r in recordings:
        r.qpos[:, 3:] /= np.linalg.norm(r.qpos[:, 3:], axis=1, keepdims=True)
    p = prepared_of(FLYER, recordings)
    assert floor(p, NOTHING, p.config.decide_s).loss < 2.0
