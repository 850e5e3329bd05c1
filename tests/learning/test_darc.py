"""DARC's classifiers on densities that are known; its reward keeps an agent from what the target lacks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.learning import agent, darc
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.darc import DARCConfig, Rows
from mpge_jax.learning.sac import SACConfig
from tests.probes import Probe

MOVED = 0.8


def rows(key, size: int, moved: float, spread: float = 1.0) -> Rows:
    """s ~ U(-1, 1), a ~ N(s, spread), s' ~ N(a + moved, 1)."""
    one, two, three = jax.random.split(key, 3)
    obs = jax.random.uniform(one, (size, 1), minval=-1.0)
    action = obs + spread * jax.random.normal(two, (size, 1))
    return Rows(obs, action, action + moved + jax.random.normal(three, (size, 1)))


def test_the_correction_is_the_log_ratio_of_the_densities():
    """log N(s'; a + m, 1) - log N(s'; a, 1) = m (s' - a) - m^2 / 2, whatever the policies were (section 4)."""
    config = DARCConfig(hidden=(32,), learning_rate=3e-3, noise=0.0, batch_size=512)

    def step(state, key):
        one, two, three = jax.random.split(key, 3)
        # Other actions are taken in the target: what tells (s, a) apart must not count.
        source, target = rows(one, 512, 0.0), rows(two, 512, MOVED, spread=0.7)
        return darc.update(state, source, target, three, config)

    state = darc.init(jax.random.key(0), 1, 1, config)
    state, metrics = jax.jit(lambda s: jax.lax.scan(step, s, jax.random.split(jax.random.key(1), 800)))(state)
    assert np.mean(metrics["classifier_loss"][-100:]) < np.mean(metrics["classifier_loss"][:20])
    seen = rows(jax.random.key(2), 500, 0.0, spread=0.7)
    found = np.asarray(darc.correction(state, seen, config))
    exact = np.asarray(MOVED * (seen.next_obs - seen.action)[:, 0] - MOVED**2 / 2)
    assert np.corrcoef(found, exact)[0, 1] > 0.97
    assert np.mean(np.abs(found - exact)) < 0.2


def test_the_correction_of_equal_dynamics_is_nothing_and_it_has_a_limit():
    config = DARCConfig(hidden=(8,), limit=0.5)
    state = darc.init(jax.random.key(0), 1, 1, config)
    pushed = state.replace(with_next=jax.tree.map(lambda x: 100.0 * x, state.with_next))
    found = np.asarray(darc.correction(pushed, rows(jax.random.key(1), 200, 0.0), config))
    assert np.abs(found).max() == 0.5 and len(set(np.sign(found))) == 2
    same = state.replace(with_next=jax.tree.map(jnp.zeros_like, state.with_next))
    same = same.replace(without=jax.tree.map(jnp.zeros_like, state.without))
    assert not np.any(darc.correction(same, rows(jax.random.key(1), 20, 0.0), config))


def broken(sign: float) -> Probe:
    """One step from 0 to `a`, or to `|a|` in the target: reward `-(a - sign 0.5)^2` in the source."""

    def advance(obs, action):
        return action, -jnp.square(action[0] - sign * 0.5), jnp.ones(())

    return Probe("Broken", 1, lambda key: jnp.zeros(1), advance)


@pytest.mark.parametrize(("noise", "avoided"), [(0.05, True), (0.05, False)])
def test_an_agent_avoids_what_the_target_cannot_do(noise, avoided):
    """Negative actions lead to where the target never gets: worth more to the task, they cost more than they bring."""
    env = broken(-1.0 if avoided else 1.0)
    actions = jax.random.uniform(jax.random.key(5), (256, 1), minval=-1.0)
    log = Rows(jnp.zeros((256, 1)), actions, jnp.abs(actions))
    sac = SACConfig(hidden=(32,), batch_size=64, actor_lr=3e-3, critic_lr=3e-3, alpha_lr=3e-3)
    config = AgentConfig(
        sac,
        num_envs=16,
        steps_per_iteration=8,
        updates_per_iteration=32,
        random_steps=256,
        buffer_capacity=8_000,
    )
    settings = DARCConfig(hidden=(32,), learning_rate=3e-3, noise=noise, batch_size=64)
    state = jax.jit(lambda key: darc.init_agent(key, env, config, settings))(jax.random.key(0))
    iterate = jax.jit(lambda s, warm_up: darc.iterate(s, env, log, jnp.array(256), config, settings, warm_up))
    for k in range(30):
        state, metrics = iterate(state, 96)
        assert (float(metrics["correction"]) == 0.0) == (k < 3)
    chosen = float(agent.sac.act(state.agent.learner.actor, jnp.zeros(1))[0])
    # Without the correction it would be -0.5 or 0.5.
    assert (chosen > -0.2) if avoided else (0.3 < chosen < 0.8)


@pytest.mark.parametrize(
    "wrong", [{"noise": -1.0}, {"learning_rate": 0.0}, {"limit": 0.0}, {"batch_size": 0}]
)
def test_values_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match="must be positive"):
        DARCConfig(**wrong)
