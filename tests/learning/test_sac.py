"""SAC against hand-worked numbers, and on probe environments whose best actions and values are known."""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.learning import buffer as replay
from mpge_jax.learning import sac
from mpge_jax.learning.buffer import Transition
from mpge_jax.learning.sac import Actor, SACConfig
from tests import probes

TINY = SACConfig(hidden=(1,), gamma=0.9, tau=0.25, batch_size=2)
SMALL = SACConfig(hidden=(8, 8), batch_size=16)


def dense(*layers: tuple[list, list]) -> dict:
    """Parameters of an MLP from `(kernel, bias)` pairs."""
    names = (f"Dense_{i}" for i in range(len(layers)))
    return {
        "params": {
            name: {"kernel": jnp.array(kernel, jnp.float32), "bias": jnp.array(bias, jnp.float32)}
            for name, (kernel, bias) in zip(names, layers, strict=True)
        }
    }


def tiny_state(log_alpha: float = 0.0) -> sac.SACState:
    """One hidden unit: mean = relu(s) / 2, log_std = -1; Q1 = 2 relu(s + a) + 1, Q2 = 3 relu(s + a) - 1."""
    actor = Actor(dense(([[1.0]], [0.0]), ([[0.5, 0.0]], [0.0, -1.0])), jnp.array([2.0]), jnp.array([0.0]))
    q1 = dense(([[1.0], [1.0]], [0.0]), ([[2.0]], [1.0]))
    q2 = dense(([[1.0], [1.0]], [0.0]), ([[3.0]], [-1.0]))
    critic = jax.tree.map(lambda *x: jnp.stack(x), q1, q2)
    return sac.warm_start(actor, critic, jnp.array(log_alpha), TINY)


TINY_BATCH = Transition(
    obs=jnp.array([[1.0], [2.0]]),
    action=jnp.array([[0.5], [-1.0]]),
    reward=jnp.array([1.0, 2.0]),
    next_obs=jnp.array([[2.0], [4.0]]),
    terminated=jnp.array([0.0, 1.0]),
)


@pytest.fixture
def the_mode_is_drawn(monkeypatch):
    """Samples are the mode, with a log-probability of -2, so that losses can be worked out by hand."""

    def mode(key, mean, log_std):
        return jnp.tanh(mean), jnp.full(mean.shape[:-1], -2.0), mean

    monkeypatch.setattr(sac, "tanh_gaussian_sample", mode)
    return _update_with_the_mode


# Traced only where the fixture above has changed what a sample is.
_update_with_the_mode = jax.jit(lambda *args: sac.update(*args), static_argnums=3)


update_many = jax.jit(sac.update_many, static_argnames=("n", "config"))


# Small programs, one for each operation outside of `jit`, take longer to compile than the whole.
init = jax.jit(sac.init, static_argnums=(1, 2, 4))


@partial(jax.jit, static_argnums=0)
def random_episodes(probe: probes.Probe, key_reset: jax.Array, key_act: jax.Array) -> replay.ReplayBuffer:
    buffer = replay.init(4096, probe.observation_size, probe.action_size)
    state = jax.vmap(probe.reset)(jax.random.split(key_reset, 2048))
    shape = (probe.max_steps, 2048, probe.action_size)
    for action in jax.random.uniform(key_act, shape, minval=-probe.limit, maxval=probe.limit):
        after = jax.vmap(probe.step)(state, action)
        info = after.info
        batch = Transition(state.obs, action, after.reward, info["next_obs"], info["terminated"])
        buffer, state = replay.add_batch(buffer, batch), after
    return buffer


def learn(probe: probes.Probe, config: SACConfig, seed: int = 0) -> sac.SACState:
    """SAC on 2,048 uniformly random episodes of `probe`."""
    key_reset, key_act, key_init, key_update = jax.random.split(jax.random.key(seed), 4)
    buffer = random_episodes(probe, key_reset, key_act)
    learner = init(key_init, probe.observation_size, probe.action_size, probe.action_high, config)
    return update_many(learner, buffer, key_update, 3000, config)[0]


# The temperature is so low that Q is the expected return to within 1%.
COLD = SACConfig(
    hidden=(32,),
    actor_lr=3e-3,
    critic_lr=3e-3,
    tau=0.05,
    gamma=0.9,
    batch_size=64,
    init_alpha=1e-2,
    alpha_lr=1e-9,
)


class TestLosses:
    def test_critic(self, the_mode_is_drawn):
        _, metrics = the_mode_is_drawn(tiny_state(), TINY_BATCH, jax.random.key(0), TINY)
        # First row:  a' = 2 tanh(relu(2) / 2); min(Q1, Q2)(s', a') = 2 (2 + a') + 1 as 2 + a' > 2;
        #             y = 1 + 0.9 (min Q + 2).          Q1 = 2 * 1.5 + 1 = 4, Q2 = 3 * 1.5 - 1 = 3.5
        # Second row: terminated, y = 2.                Q1 = 2 * 1.0 + 1 = 3, Q2 = 3 * 1.0 - 1 = 2
        y = 1 + 0.9 * (2 * (2 + 2 * math.tanh(1.0)) + 1 + 2)
        expected = 0.5 * (((4 - y) ** 2 + (3 - 2) ** 2) / 2 + ((3.5 - y) ** 2 + (2 - 2) ** 2) / 2)
        assert metrics["critic_loss"] == pytest.approx(expected, rel=1e-6)
        assert metrics["q_mean"] == pytest.approx((4 + 3 + 3.5 + 2) / 4)
        assert metrics["entropy"] == pytest.approx(2.0)

    def test_temperature_weighs_the_entropy_in_the_target(self, the_mode_is_drawn):
        _, metrics = the_mode_is_drawn(tiny_state(math.log(0.5)), TINY_BATCH, jax.random.key(0), TINY)
        y = 1 + 0.9 * (2 * (2 + 2 * math.tanh(1.0)) + 1 + 0.5 * 2)
        expected = 0.5 * (((4 - y) ** 2 + (3 - 2) ** 2) / 2 + ((3.5 - y) ** 2 + (2 - 2) ** 2) / 2)
        assert metrics["critic_loss"] == pytest.approx(expected, rel=1e-6)

    def test_actor_learns_from_the_new_critics(self, the_mode_is_drawn):
        state = tiny_state(math.log(0.5))
        after, metrics = the_mode_is_drawn(state, TINY_BATCH, jax.random.key(0), TINY)
        action = sac.act(state.actor, TINY_BATCH.obs)
        q = sac.q_values(after.critic, TINY_BATCH.obs, action, TINY).min(axis=0)
        assert metrics["actor_loss"] == pytest.approx(float((0.5 * -2.0 - q).mean()), rel=1e-6)

    def test_first_steps_of_adam_have_the_size_of_the_learning_rates(self, the_mode_is_drawn):
        config = dataclasses.replace(TINY, actor_lr=0.01, critic_lr=0.02, alpha_lr=0.03, target_entropy=1.0)
        state = tiny_state()
        after, _ = the_mode_is_drawn(state, TINY_BATCH, jax.random.key(0), config)
        moved = jax.tree.map(lambda new, old: new - old, after, state)
        # y is above Q1 and Q2 on average, so both output biases rise.
        np.testing.assert_allclose(moved.critic["params"]["Dense_1"]["bias"], [[0.02], [0.02]], rtol=1e-3)
        # Q grows with the action, so the mean does; log_std has no gradient at the mode.
        np.testing.assert_allclose(moved.actor.params["params"]["Dense_1"]["bias"], [0.01, 0.0], rtol=1e-3)
        # Entropy 2 above its target 1: the temperature falls.
        assert moved.log_alpha == pytest.approx(-0.03, rel=1e-3)
        assert moved.step == 1
        np.testing.assert_array_equal(moved.actor.action_scale, 0.0)

    @pytest.mark.parametrize(("target_entropy", "direction"), [(10.0, 1), (-10.0, -1), (None, -1)])
    def test_temperature_rises_where_the_entropy_is_too_low(
        self, the_mode_is_drawn, target_entropy, direction
    ):
        # Entropy 2; the default target is minus the number of actions, -1.
        config = dataclasses.replace(TINY, target_entropy=target_entropy)
        state = tiny_state()
        after, _ = the_mode_is_drawn(state, TINY_BATCH, jax.random.key(0), config)
        assert jnp.sign(after.log_alpha - state.log_alpha) == direction

    def test_targets_follow_the_new_critics(self):
        state = tiny_state()
        after, _ = jax.jit(sac.update, static_argnums=3)(state, TINY_BATCH, jax.random.key(0), TINY)
        expected = jax.tree.map(lambda new, old: 0.25 * new + 0.75 * old, after.critic, state.target_critic)
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-6), after.target_critic, expected)


class TestProbes:
    @pytest.mark.parametrize(("terminates", "value"), [(True, 1.0), (False, 10.0)])
    def test_only_termination_ends_the_value(self, terminates, value):
        state = learn(probes.clock(terminates), COLD)
        q = sac.q_values(state.critic, jnp.ones((5, 1)), jnp.linspace(-1, 1, 5)[:, None], COLD)
        np.testing.assert_allclose(q, value, rtol=0.05)

    def test_the_discount_is_applied_once_a_step(self):
        state = learn(probes.delayed(), COLD)
        action = jnp.array([[-0.8], [0.0], [0.8]])
        first, second = jnp.zeros((3, 2)), jnp.concatenate([jnp.ones((3, 1)), action], axis=1)
        np.testing.assert_allclose(
            sac.q_values(state.critic, second, action, COLD)[0], action[:, 0], atol=0.1
        )
        np.testing.assert_allclose(
            sac.q_values(state.critic, first, action, COLD)[0], 0.9 * action[:, 0], atol=0.1
        )
        assert sac.act(state.actor, jnp.zeros(2))[0] > 0.9

    def test_finds_the_best_action_in_the_environments_units(self):
        state = learn(probes.bandit(optimum=0.9, limit=3.0), COLD)
        assert sac.act(state.actor, jnp.ones(1))[0] == pytest.approx(0.9, abs=0.15)

    def test_finds_the_best_action_of_every_state(self):
        state = learn(probes.contextual_bandit(slope=0.5), COLD)
        obs = jnp.linspace(-0.9, 0.9, 7)[:, None]
        np.testing.assert_allclose(sac.act(state.actor, obs), 0.5 * obs, atol=0.1)

    def test_the_temperature_brings_the_entropy_to_its_target(self):
        config = dataclasses.replace(COLD, init_alpha=1.0, alpha_lr=1e-2, target_entropy=-0.5)
        state = learn(probes.bandit(), config)
        obs = jnp.ones((4000, 1))
        mean, log_std = sac.distribution(state.actor, obs)
        _, log_prob, _ = sac.tanh_gaussian_sample(jax.random.key(1), mean, log_std)
        assert -log_prob.mean() == pytest.approx(-0.5, abs=0.15)
        assert sac.act(state.actor, obs[0])[0] == pytest.approx(0.3, abs=0.1)


class TestActing:
    def test_mode_and_samples_by_hand(self):
        actor = tiny_state().actor
        obs = jnp.full((20_000, 1), 2.0)
        np.testing.assert_allclose(sac.act(actor, obs[:1]), [[2 * math.tanh(1.0)]], rtol=1e-6)
        pre_tanh = jnp.arctanh(sac.act(actor, obs, jax.random.key(0)) / 2)
        # Standard errors: 0.0026 of the mean, 0.0018 of the standard deviation.
        assert pre_tanh.mean() == pytest.approx(1.0, abs=0.013)
        assert pre_tanh.std() == pytest.approx(math.exp(-1), abs=0.01)

    def test_every_action_has_its_own_scale(self):
        state = init(jax.random.key(0), 3, 2, jnp.array([1.0, 5.0]), SMALL)
        obs = 100 * jax.random.normal(jax.random.key(1), (200, 3))
        action = np.abs(sac.act(state.actor, obs, jax.random.key(2)))
        assert np.all(action <= np.array([[1.0, 5.0]]))
        assert action[:, 1].max() > 3.0

    def test_takes_one_observation_or_any_batch_of_them(self):
        actor = init(jax.random.key(0), 3, 2, jnp.ones(2), SMALL).actor
        obs = jax.random.normal(jax.random.key(1), (4, 5, 3))
        action = sac.act(actor, obs)
        assert action.shape == (4, 5, 2)
        np.testing.assert_allclose(sac.act(actor, obs[1, 2]), action[1, 2], rtol=1e-5)

    def test_entropy_is_that_of_the_gaussian_before_squashing(self):
        entropy = sac.policy_entropy(tiny_state().actor, jnp.ones((3, 1)))
        np.testing.assert_allclose(entropy, -1.0 + 0.5 * math.log(2 * math.pi * math.e), rtol=1e-6)

    def test_log_std_is_bounded(self):
        actor = tiny_state().actor
        for bias, bound in ((-50.0, -20.0), (50.0, 2.0)):
            params = dense(([[1.0]], [0.0]), ([[0.5, 0.0]], [0.0, bias]))
            assert sac.distribution(actor.replace(params=params), jnp.ones(1))[1] == bound


def example(key: jax.Array) -> tuple[sac.SACState, replay.ReplayBuffer]:
    """A learner and a buffer of 50 random transitions with 3 observations and 2 actions."""
    keys = jax.random.split(key, 5)
    batch = Transition(
        obs=jax.random.normal(keys[0], (50, 3)),
        action=jax.random.uniform(keys[1], (50, 2), minval=-1.0),
        reward=jax.random.normal(keys[2], (50,)),
        next_obs=jax.random.normal(keys[3], (50, 3)),
        terminated=jnp.zeros(50),
    )
    return sac.init(keys[4], 3, 2, jnp.ones(2), SMALL), replay.add_batch(replay.init(64, 3, 2), batch)


compiled_example = jax.jit(example)

assert_close = partial(jax.tree.map, partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5))


class TestPrograms:
    def test_many_updates_are_a_loop_of_single_ones(self):
        start, buffer = compiled_example(jax.random.key(0))
        many, metrics = update_many(start, buffer, jax.random.key(1), 5, SMALL)
        state, single = start, []
        update = jax.jit(partial(sac.update, config=SMALL))
        for key in jax.random.split(jax.random.key(1), 5):
            sample_key, update_key = jax.random.split(key)
            state, m = update(state, replay.sample(buffer, sample_key, SMALL.batch_size), update_key)
            single.append(m)
        assert_close(many, state)
        assert_close(metrics, jax.tree.map(lambda *x: np.mean(x), *single))
        assert many.step == 5

    def test_seeds_under_vmap_are_separate_runs(self):
        keys = jax.random.split(jax.random.key(0), 3)
        states, buffers = jax.tree.map(lambda *x: jnp.stack(x), *[compiled_example(key) for key in keys])
        run = jax.jit(jax.vmap(partial(sac.update_many, n=5, config=SMALL)))
        together, _ = run(states, buffers, keys)
        alone, _ = update_many(*compiled_example(keys[1]), keys[1], 5, SMALL)
        assert_close(jax.tree.map(lambda x: x[1], together), alone)
        assert not np.allclose(together.log_alpha[0], together.log_alpha[1], rtol=1e-9, atol=0.0)

    def test_a_learner_and_its_buffer_can_be_donated(self):
        learner = example(jax.random.key(0))
        # Fails where one array stands at two places of the state.
        state, buffer = jax.jit(lambda x: x, donate_argnums=0)(learner)
        assert learner[0].log_alpha.is_deleted()
        assert buffer.size == 50 and state.step == 0


class TestStart:
    def test_two_different_critics_and_equal_targets(self):
        state = init(jax.random.key(0), 3, 2, jnp.ones(2), SMALL)
        kernel = state.critic["params"]["Dense_0"]["kernel"]
        assert kernel.shape == (2, 5, 8)
        assert not np.allclose(kernel[0], kernel[1])
        assert np.abs(kernel).max() <= 1 / math.sqrt(5)
        jax.tree.map(np.testing.assert_array_equal, state.critic, state.target_critic)
        assert state.log_alpha == 0.0

    def test_warm_start_keeps_actor_critics_and_temperature_only(self):
        start, buffer = compiled_example(jax.random.key(0))
        trained, _ = update_many(start, buffer, jax.random.key(1), 5, SMALL)
        warm = sac.warm_start(trained.actor, trained.critic, trained.log_alpha, SMALL)
        same = partial(jax.tree.map, np.testing.assert_array_equal)
        same((warm.actor, warm.critic, warm.log_alpha), (trained.actor, trained.critic, trained.log_alpha))
        same(warm.target_critic, trained.critic)
        same(
            (warm.actor_opt, warm.critic_opt, warm.alpha_opt),
            (start.actor_opt, start.critic_opt, start.alpha_opt),
        )
        assert warm.step == 0

    def test_a_policy_survives_the_donation_of_what_it_started(self):
        policy = sac.init(jax.random.key(0), 3, 2, jnp.ones(2), SMALL)
        warm = sac.warm_start(policy.actor, policy.critic, policy.log_alpha, SMALL)
        jax.jit(lambda state: state, donate_argnums=0)(warm)
        assert np.isfinite(sac.act(policy.actor, jnp.ones(3))).all()


class TestBadInput:
    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("hidden", ()),
            ("hidden", (256, 0)),
            ("actor_lr", 0.0),
            ("critic_lr", -1.0),
            ("alpha_lr", float("nan")),
            ("init_alpha", 0.0),
            ("tau", 0.0),
            ("tau", 1.5),
            ("gamma", -0.1),
            ("gamma", float("nan")),
            ("batch_size", 0),
        ],
    )
    def test_configuration(self, field, value):
        with pytest.raises(ValueError, match=f"{field} must"):
            SACConfig(**{field: value})

    def test_action_scale(self):
        with pytest.raises(ValueError, match=r"action_scale must have shape \(2,\), got \(3,\)"):
            sac.init(jax.random.key(0), 3, 2, jnp.ones(3), SMALL)

    def test_policy_of_another_size(self):
        policy = sac.init(jax.random.key(0), 3, 2, jnp.ones(2), SMALL)
        with pytest.raises(
            ValueError, match=r"have hidden layers \(8, 8\), the configuration wants \(256, 256\)"
        ):
            sac.warm_start(policy.actor, policy.critic, policy.log_alpha, SACConfig())

    def test_reward_column(self):
        batch = TINY_BATCH.replace(reward=TINY_BATCH.reward[:, None])
        with pytest.raises(
            ValueError, match=r"reward of the transitions must have shape \(2,\), got \(2, 1\)"
        ):
            sac.update(tiny_state(), batch, jax.random.key(0), TINY)

    def test_no_updates(self):
        with pytest.raises(ValueError, match="at least 1, got 0"):
            sac.update_many(*compiled_example(jax.random.key(0)), jax.random.key(1), 0, SMALL)
