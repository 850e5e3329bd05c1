"""Grounding: what is collected, judged, rewarded and handed to the learners, and that it works."""

import dataclasses
from collections import Counter
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import mpge_jax
from mpge_jax.grounding import adversarial, collect, discriminator, ensemble, transform_error, transformer
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig, Transitions
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning import sac
from mpge_jax.learning.trpo import TRPOConfig
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.target_log import TargetLog
from tests import points, small

CONFIG = GroundingConfig(
    num_envs=8,
    steps_per_iteration=24,
    iterations=2,
    transformer=TransformerConfig(hidden=(8,), init_log_std=1.0),
    policy=TRPOConfig(cg_iterations=3),
    discriminator=DiscriminatorConfig(hidden=(8,)),
    discriminator_updates=2,
    discriminator_batch=64,
    value_epochs=1,
    value_minibatch=64,
)
SOURCE = "InvertedPendulum"
LOW, HIGH = np.array([-3.0], np.float32), np.array([3.0], np.float32)


def collected_rows(key, state, env, actors, log, config):
    begun = state.env_state, state.rollout_policy
    return collect.collect(key, state.current, begun, env, actors, log, config)[1]


def collected(config: GroundingConfig):
    """Rows `[T, B, ...]` of one collection, by policies without spread, and the state that collected them."""
    env, log = small.env(SOURCE), small.log(log_std=-18.0)
    actors = small.policy_set(log_std=-18.0).rollout

    @jax.jit
    def run(key):
        state = adversarial.init(key, env, actors, log, config)
        return state, collected_rows(jax.random.key(1), state, env, actors, log, config)

    state, rows = run(jax.random.key(0))
    shape = (config.steps_per_iteration, config.num_envs)
    return state, jax.tree.map(lambda x: np.asarray(x).reshape(*shape, *x.shape[1:]), rows)


@pytest.fixture(scope="module")
def episodes():
    return collected(CONFIG)


@pytest.fixture(scope="module")
def restarted():
    return collected(dataclasses.replace(CONFIG, restart_steps=3))


def test_a_simulator_that_diverges_leaves_a_row_that_can_be_learned_from():
    """Its row leads nowhere, and it starts anew; the others go on."""
    env, log = small.env(SOURCE), small.log(log_std=-18.0)
    actors = small.policy_set(log_std=-18.0).rollout
    config = dataclasses.replace(CONFIG, steps_per_iteration=1, value_minibatch=8)

    @jax.jit
    def run(key):
        state = adversarial.init(key, env, actors, log, config)
        lost = state.env_state.data.replace(qvel=state.env_state.data.qvel.at[0].set(jnp.nan))
        begun = state.env_state.replace(data=lost), state.rollout_policy
        after, rows = collect.collect(key, state.current, begun, env, actors, log, config)
        return after[0], rows, collect.expected_next(env, jnp.full((1, 4), jnp.inf), jnp.zeros((1, 1)))

    after, rows, expected = run(jax.random.key(0))
    np.testing.assert_array_equal(rows.next_observation[0], rows.observation[0])
    assert np.any(rows.next_observation[1] != rows.observation[1])
    np.testing.assert_array_equal(after.info["steps"], [0, *[1] * 7])
    assert np.isfinite(after.obs).all() and np.isinf(expected).all()


@pytest.mark.parametrize("mode", ["episodes", "restarted"])
def test_a_row_is_state_raw_action_and_where_the_transformed_action_led(mode, request):
    _, rows = request.getfixturevalue(mode)
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), rows)
    executed = np.clip(flat.action + np.clip(flat.delta, -6.0, 6.0), LOW, HIGH)
    reached = small.step_from(SOURCE, flat.observation, executed)
    # The engine's warm start, which a state rebuilt from an observation lacks, is the difference.
    np.testing.assert_allclose(flat.next_observation, reached, atol=2e-5)
    # What was asked for would have led elsewhere.
    asked = small.step_from(SOURCE, flat.observation, flat.action)
    assert np.median(np.abs(flat.next_observation - asked).max(axis=1)) > 0.05


@pytest.mark.parametrize("mode", ["episodes", "restarted"])
def test_the_action_is_the_one_of_the_policy_named_in_the_row(mode, request):
    _, rows = request.getfixturevalue(mode)
    actors = small.policy_set(log_std=-18.0).rollout
    asked = jax.vmap(lambda actor: sac.act(actor, jnp.asarray(rows.observation)))(actors.params)
    own = np.take_along_axis(np.asarray(asked), rows.rollout_policy[None, ..., None], axis=0)[0]
    np.testing.assert_allclose(rows.action, own, atol=1e-4)
    assert set(np.unique(rows.rollout_policy)) == {0, 1, 2}


def test_the_log_probability_is_of_the_unclipped_delta(episodes):
    state, rows = episodes
    mean, log_std = transformer.distribution(
        state.current, jnp.asarray(rows.observation), jnp.asarray(rows.action)
    )
    expected = stats.norm.logpdf(rows.delta, mean, np.exp(log_std)).sum(axis=-1)
    np.testing.assert_allclose(rows.log_prob, expected, rtol=1e-4, atol=1e-4)
    # With this spread some draws lie beyond both clips.
    assert (np.abs(rows.delta) > 6.0).any()


def test_an_episode_keeps_its_policy_and_the_next_one_draws_anew(episodes):
    _, rows = episodes
    over = np.abs(rows.next_observation[:-1, :, 1]) > 0.2
    np.testing.assert_array_equal(rows.observation[1:][~over], rows.next_observation[:-1][~over])
    assert np.abs(rows.observation[1:][over]).max() <= 0.01
    before, after = rows.rollout_policy[:-1], rows.rollout_policy[1:]
    np.testing.assert_array_equal(before[~over], after[~over])
    # Each of three policies follows itself in a third of the resets.
    assert over.sum() > 12
    assert 0.3 < np.mean(before[over] != after[over]) < 1.0


def test_restarted_episodes_begin_in_states_of_their_own_policy_and_end_in_time(restarted):
    _, rows = restarted
    log = small.log(log_std=-18.0)
    logged = [np.asarray(log.observation)[k, : int(log.count[k])] for k in range(3)]
    length = np.zeros(CONFIG.num_envs, int)
    starts, lengths = 0, Counter()
    for t in range(len(rows.observation)):
        for b in range(CONFIG.num_envs):
            if length[b] == 0:
                distance = np.abs(logged[rows.rollout_policy[t, b]] - rows.observation[t, b]).max(axis=1)
                assert distance.min() < 1e-6
                starts += 1
            else:
                np.testing.assert_array_equal(rows.observation[t, b], rows.next_observation[t - 1, b])
            length[b] += 1
            if length[b] == 3 or np.abs(rows.next_observation[t, b, 1]) > 0.2:
                lengths[length[b]] += 1
                length[b] = 0
    assert starts >= 8 * 24 // 3
    assert set(lengths) <= {1, 2, 3} and lengths[3] > 0


def marked_log(counts: list[int]) -> TargetLog:
    """Rows that say which policy and row they are; padding that no arithmetic survives."""
    most = max(counts)
    policy = np.repeat(np.arange(3.0)[:, None], most, axis=1)
    row = np.repeat(np.arange(float(most))[None], 3, axis=0)
    mark = np.stack([policy, row], axis=-1).astype(np.float32)
    mark[np.arange(most)[None] >= np.array(counts)[:, None]] = np.nan
    zeros = jnp.zeros((3, most))
    return TargetLog(
        jnp.asarray(mark), jnp.asarray(mark[..., :1] * 10 + mark[..., 1:]), jnp.asarray(mark + 100), zeros, zeros,
        jnp.array(counts),
    )  # fmt: skip


def test_target_rows_match_the_policies_of_the_grounded_rows(monkeypatch):
    original = discriminator.update

    def exposed(state, grounded, target, key, config):
        state, metrics = original(state, grounded, target, key, config)
        return state, {**metrics, "grounded": grounded, "target": target}

    monkeypatch.setattr(discriminator, "update", exposed)
    # Policy 1 acts in half of the rows, policy 2 in none of them.
    which = jnp.array([0, 1, 1, 0] * 25)
    rows = jnp.arange(100.0)
    mark = jnp.stack([which.astype(jnp.float32), rows], axis=-1)
    grounded = Transitions(mark, rows[:, None], mark + 100)
    state = discriminator.init(jax.random.key(0), 2, 1, CONFIG.discriminator)
    update = jax.jit(partial(adversarial.update_discriminator, config=CONFIG))
    log = marked_log([4, 7, 2])
    grounded = grounded.replace(expected=mark + 50)
    _, metrics = update(jax.random.key(3), state, grounded, which, log, log.observation + 50)
    found, target = jax.tree.map(np.asarray, (metrics["grounded"], metrics["target"]))
    assert np.isfinite(target.observation).all()
    np.testing.assert_array_equal(
        np.bincount(found.observation[:, 0].astype(int)), np.bincount(target.observation[:, 0].astype(int))
    )
    # All rows of a log are drawn, none beyond its count, and (s, a, s') stay together on both sides.
    assert set(target.observation[target.observation[:, 0] == 0, 1]) == set(range(4))
    assert set(target.observation[target.observation[:, 0] == 1, 1]) == set(range(7))
    np.testing.assert_array_equal(target.action[:, 0], target.observation @ np.array([10.0, 1.0]))
    np.testing.assert_array_equal(target.next_observation, target.observation + 100)
    np.testing.assert_array_equal(target.expected, target.observation + 50)
    np.testing.assert_array_equal(found.action[:, 0], found.observation[:, 1])
    np.testing.assert_array_equal(found.expected, found.observation + 50)
    np.testing.assert_array_equal(found.next_observation, found.observation + 100)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"iterations": 1.5}, "iterations must be a whole number, got 1.5"),
        ({"num_envs": "64"}, "num_envs must be a whole number, got '64'"),
        ({"restart_steps": -1}, "restart_steps must not be negative"),
        ({"averaging": 1.0}, r"averaging must lie in \[0, 1\)"),
        ({"value_minibatch": 4096}, "value_minibatch of 4096 exceeds the batch of 192"),
    ],
)
def test_a_configuration_out_of_range_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(CONFIG, **change)


@pytest.fixture(scope="module")
def alone():
    """One transformer grounded on its own, without interruption, with what it was grounded on."""
    arguments = points.policies(), points.log(), points.CONFIG, jax.random.key(2)
    return partial(mpge_jax.ground, points.SOURCE, truth=points.truth, quiet=True), arguments


@pytest.fixture(scope="module")
def whole(alone):
    ground, arguments = alone
    return ground(*arguments)


def test_an_interrupted_grounding_has_the_bits_of_an_uninterrupted_one(monkeypatch, tmp_path, alone, whole):
    ground, (policies_, log, config, key) = alone
    run = ensemble.loop.run
    first_half = lambda update, state, _, **options: run(update, state, 1, **options)  # noqa: E731
    monkeypatch.setattr(ensemble.loop, "run", first_half)
    ground(policies_, log, config, key, folder=tmp_path / "a")
    monkeypatch.setattr(ensemble.loop, "run", run)
    resumed = ground(policies_, log, config, key, folder=tmp_path / "a")
    jax.tree.map(np.testing.assert_array_equal, resumed, whole)
    curve = whole[1]
    assert {"error_uniform", "error_own", "reward", "log_std", "d_accuracy_target"} <= set(curve)
    assert all(values.shape == (config.iterations,) for values in curve.values())

    other_log = log.replace(action=log.action.at[0, 0].add(0.5))
    with pytest.raises(ValueError, match="is of another run: log differ"):
        ground(policies_, other_log, config, key, folder=tmp_path / "a")
    with pytest.raises(ValueError, match="is of another run: keys, policies differ"):
        ground(points.policies(0.1), log, config, jax.random.key(4), folder=tmp_path / "a")


def test_shapes_that_do_not_match_are_named():
    env, keys = small.env(SOURCE), jax.random.split(jax.random.key(0), 2)
    two = lambda tree: small.stacked(tree, tree)  # noqa: E731
    sets, logs = two(small.policy_set().rollout), two(small.log())
    ground = partial(mpge_jax.ground_ensemble, config=CONFIG, keys=keys, quiet=True)
    with pytest.raises(ValueError, match="2 keys ask for as many target logs"):
        ground(env, sets, small.stacked(small.log()))
    with pytest.raises(ValueError, match="2 keys ask for as many rollout policies"):
        ground(env, small.policy_set().rollout, logs)
    with pytest.raises(ValueError, match="2 keys ask for as many starting transformers"):
        ground(env, sets, logs, start=small.stacked(small.constant(env, 0.0)))
    with pytest.raises(ValueError, match="cannot act on the 17 observations of HalfCheetah"):
        ground(small.env("HalfCheetah"), sets, logs)
    with pytest.raises(ValueError, match="log is of 3 rollout policies, but 2 policies were given"):
        ground(env, two(small.policy_set(size=2).rollout), logs)
    broken = small.log().replace(action=small.log().action.at[1, 2].set(jnp.nan))
    with pytest.raises(ValueError, match="action of policy 1 is not finite in row 2"):
        ground(env, sets, small.stacked(small.log(), broken))


def test_what_stands_in_the_wrong_place_is_named():
    policies, log, config, key = points.policies(), points.log(), points.CONFIG, jax.random.key(0)
    ground = partial(mpge_jax.ground, points.SOURCE, quiet=True)
    with pytest.raises(ValueError, match="the rollout policies must be a RolloutPolicies, not TargetLog"):
        ground(log, policies, config, key)
    with pytest.raises(ValueError, match="the target log must be a TargetLog, not NoneType"):
        ground(policies, None, config, key)
    with pytest.raises(ValueError, match="the config must be a GroundingConfig, not dict"):
        ground(policies, log, {"iterations": 1}, key)
    with pytest.raises(ValueError, match=r"the key must be one of JAX, as jax.random.key\(0\), not int"):
        ground(policies, log, config, 0)


def test_a_start_is_gone_on_from_and_stays_usable():
    start = small.constant(points.SOURCE, 0.5)
    config = dataclasses.replace(points.CONFIG, transformer=TransformerConfig(hidden=()), iterations=1)
    learned, _ = mpge_jax.ground(
        points.SOURCE, points.policies(), points.log(), config, jax.random.key(0), start=start, quiet=True
    )
    moved = transformer.deterministic(
        learned, jnp.zeros(1), jnp.zeros(1), points.SOURCE.action_low, points.SOURCE.action_high
    )
    assert 0.25 < float(moved[0]) < 0.75 and float(moved[0]) != 0.5
    np.testing.assert_array_equal(start.params["mean"]["params"]["Dense_0"]["bias"], [0.5])


@pytest.mark.slow
def test_grounding_finds_the_skew_of_the_pendulum():
    """The paper's way with the shipped policies. Doing nothing is 1.31 away from the truth (1.5, where unclipped)."""
    env, target = small.env(SOURCE), small.env("SkewedPendulum")
    truth = transform_error.truth_of(target)
    shipped, _ = policies.shipped(SOURCE, "MS")
    config = GroundingConfig(
        num_envs=64,
        steps_per_iteration=8,
        iterations=60,
        transformer=TransformerConfig(init_log_std=-0.5),
        policy=TRPOConfig(max_kl=0.03),
        discriminator=DiscriminatorConfig(hidden=(64, 64), learning_rate=1e-3, penalty_coefficient=3.0),
        discriminator_batch=128,
        value_epochs=2,
        averaging=0.8,
    )
    log = target_log.collect(jax.random.key(1), target, shipped.rollout, 1000)
    pi_g, curve = mpge_jax.ground(
        env, shipped.rollout, log, config, jax.random.key(0), truth=truth, quiet=True
    )
    print({name: curve[name][9::10].round(2) for name in ("error_uniform", "error_own", "log_std", "reward")})
    assert curve["error_uniform"][0] > 1.1
    assert curve["error_own"][-1] < 0.65
    assert float(transform_error.in_rollouts(jax.random.key(2), pi_g, env, truth)) < 0.75


def test_branches_share_their_state_and_the_first_is_followed():
    config = dataclasses.replace(points.CONFIG, branches=3)
    log, policies_ = points.log(), points.policies()

    @jax.jit
    def run(key):
        state = adversarial.init(key, points.SOURCE, policies_, log, config)
        return collected_rows(jax.random.key(1), state, points.SOURCE, policies_, log, config)

    rows = jax.tree.map(
        lambda x: np.asarray(x).reshape(config.steps_per_iteration, 3, config.num_envs, *x.shape[1:]),
        run(jax.random.key(0)),
    )
    for shared in (rows.observation, rows.action, rows.rollout_policy):
        np.testing.assert_array_equal(shared, np.repeat(shared[:, :1], 3, axis=1))
    assert (rows.delta[:, 0] != rows.delta[:, 1]).all() and (rows.delta[:, 1] != rows.delta[:, 2]).all()
    np.testing.assert_array_equal(rows.observation[1:, 0], rows.next_observation[:-1, 0])
