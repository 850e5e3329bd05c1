"""What a true model leaves, and when more than that is left."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import Floor, Left, floor
from tests.diagnosis.machines import FLYER, PENDULUM, record
from tests.diagnosis.searches import prepared_of


def test_what_one_joint_leaves_does_not_drown_in_what_another_scatters():
    rng = np.random.default_rng(0)
    wild = rng.uniform(1.0, 9.0, (60, 1))
    calm = 0.9 + 0.05 * rng.standard_normal((60, 1))
    losses, typical = 0.5 * (wild + calm)[:, 0], np.ones(60, bool)
    floor_of = Floor(losses.mean(), 0.3, 1.0, losses[:32], np.hstack([wild, calm])[:32])
    assert not floor_of.beyond(Left(losses, np.hstack([wild, calm]), typical))
    # the second joint leaves twice as much as noise would, or much in a few windows
    assert floor_of.beyond(Left(losses, np.hstack([wild, 2 * calm]), typical))
    few = calm.copy()
    few[-6:] = 6.0
    assert floor_of.beyond(Left(losses, np.hstack([wild, few]), np.arange(60) < 50))
    few[-1:] = 1.0
    assert not floor_of.beyond(Left(losses, np.hstack([wild, few]), typical))


def test_the_floor_is_what_a_true_model_leaves():
    """The start is smoothed from the same rows as it is compared with, so its error and theirs are not independent."""
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), record(PENDULUM, 0.8, noise=1e-3), Config(jobs=1))
    assert d.verdict == "none"
    assert 0.5 < d.held.after.rms / d.held.floor < 1.6


def test_floor_is_lower_than_that_of_independent_errors(null):
    _, p = null
    assert floor(p, NOTHING).ratio < 1.0


def test_what_is_left_on_a_free_body_does_not_raise_the_floor():
    """A free body turned by something unknown: noise alone explains none of it."""

    def turn(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[3:6] = 0.05 * np.sin(9.0 * data.time)

    recordings = record(FLYER, 0.05, force=turn, noise=2e-4)
    for r in recordings:
        r.qpos[:, 3:] /= np.linalg.norm(r.qpos[:, 3:], axis=1, keepdims=True)
    p = prepared_of(FLYER, recordings)
    assert floor(p, NOTHING).loss < 2.0
