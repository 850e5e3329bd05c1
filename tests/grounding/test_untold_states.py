"""Logged observations that do not tell their state: no simulator is put there to learn, to be followed or judged."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding import adversarial, collect, ensemble, inversion, prediction
from mpge_jax.grounding.delta_action import DeltaConfig, TrackingEnv
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.rollouts.trajectories import trajectories
from tests import points
from tests.probes import Probe

LEAST = 0.4
"""Observations below it tell nothing: a third of the log's."""


@dataclass(frozen=True)
class Shortsighted(Probe):
    """The point, whose observation tells where it is only above `LEAST`."""

    def tells_state(self, obs):
        return obs[0] >= LEAST


ENV = Shortsighted(**vars(points.SOURCE))


def told_rows(log):
    told = np.asarray(log.observation)[..., 0] >= LEAST
    told &= np.arange(told.shape[1])[None] < np.asarray(log.count)[:, None]
    assert 0.1 < 1 - told.sum() / log.steps < 0.9
    return told


def test_rows_are_chosen_in_their_order():
    log = points.log()
    told = told_rows(log)
    chosen = log.only(jnp.asarray(np.asarray(log.observation)[..., 0] >= LEAST))
    np.testing.assert_array_equal(chosen.count, told.sum(1))
    for name in ("observation", "action", "next_observation", "episode", "terminated"):
        for k, count in enumerate(told.sum(1)):
            np.testing.assert_array_equal(getattr(chosen, name)[k, :count], getattr(log, name)[k][told[k]])


def test_grounding_begins_its_episodes_elsewhere():
    log, config = points.log(), replace(points.CONFIG, restart_steps=2, num_envs=1024)
    assert collect.starts_of(ENV, log, points.CONFIG) is log
    begun = jax.jit(lambda key: adversarial.init(key, ENV, points.policies(), log, config))(jax.random.key(0))
    seen = np.asarray(begun.env_state.obs)[:, 0]
    told = told_rows(log)
    for k in range(3):
        mine = seen[np.asarray(begun.rollout_policy) == k]
        assert set(mine) == set(np.asarray(log.observation)[k, told[k], 0])
    again = jax.jit(lambda s: adversarial.update(s, ENV, points.policies(), log, config))(begun)[0]
    fresh = np.asarray(again.env_state.info["steps"]) == 0
    assert fresh.any() and np.all(np.asarray(again.env_state.obs)[fresh, 0] >= LEAST)


def test_they_are_not_inverted():
    log = points.log()
    told = told_rows(log)
    config = InversionConfig(iterations=2)
    found = inversion.invert(ENV, log, config)
    np.testing.assert_array_equal(found.weight, told.reshape(-1))
    alone = inversion.invert(points.SOURCE, log.only(jnp.asarray(told)), config)
    np.testing.assert_allclose(
        np.asarray(found.misfit)[told.reshape(-1)], np.asarray(alone.misfit)[np.asarray(alone.weight) > 0]
    )


def test_a_log_that_tells_no_state_is_refused():
    log = jax.tree.map(lambda x: x[None], points.log())
    blind = replace(ENV, first=ENV.first)
    object.__setattr__(blind, "tells_state", lambda obs: jnp.zeros((), bool))
    with pytest.raises(ValueError, match="no observation of Point tells its state, which inversion needs"):
        ensemble.invert_ensemble(
            blind, log, InversionConfig(iterations=1), jax.random.split(jax.random.key(0), (1, 1))
        )


def test_they_do_not_judge():
    log = points.log()
    told = told_rows(log).reshape(-1)
    flat = [x.reshape(-1, 1) for x in (log.observation, log.action, log.next_observation)]
    every = prediction.HeldOut(*flat, jnp.ones(len(told)))
    alone = prediction.HeldOut(*(x[told] for x in flat), jnp.ones(told.sum()))
    found = float(prediction.error_under(ENV, every, every.action))
    assert found == pytest.approx(float(prediction.error_under(points.SOURCE, alone, alone.action)), rel=1e-5)
    assert found != pytest.approx(float(prediction.error_under(points.SOURCE, every, every.action)), rel=1e-3)
    assert np.isinf(prediction.error_under(ENV, every.replace(weight=jnp.asarray(~told)), every.action))


def test_no_trajectory_is_followed_from_them():
    rows = trajectories(points.log())
    begun = jax.vmap(TrackingEnv(ENV, rows, DeltaConfig()).reset)(jax.random.split(jax.random.key(0), 512))
    seen, logged = np.asarray(begun.data.obs)[:, 0], np.asarray(rows.observation)[: int(rows.count), 0]
    assert set(seen) == set(logged[logged >= LEAST])
    np.testing.assert_array_equal(seen, np.asarray(rows.observation)[begun.info["row"], 0])
