"""Source policies: of each training the best moment is kept."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from experiments import pretrain
from mpge_jax.learning import agent, sac
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import SACConfig
from mpge_jax.rollouts import policies
from tests import small

CONFIG = AgentConfig(
    sac=SACConfig(hidden=(8,), batch_size=8), num_envs=2, steps_per_iteration=4, updates_per_iteration=1,
    buffer_capacity=64, random_steps=8,
)  # fmt: skip


def tiny_main(out: str) -> int:
    """What processes that are killed run: a few steps of two policies, with a checkpoint after every iteration."""
    original = pretrain.loop.run
    often = {"seconds_between_checkpoints": 0.0}
    pretrain.loop.run = lambda *args, **options: original(*args, **{**options, **often})
    pretrain.CONFIGS["InvertedPendulum"] = CONFIG
    pretrain.EPISODES = pretrain.TRIAL_EPISODES = 2
    pretrain.main(pretrain.Args(count=2, updates=16, out=Path(out), quiet=True))
    return 0


@pytest.fixture(scope="module")
def training():
    env = envs.make("InvertedPendulum")
    keys = jax.random.split(jax.random.key(0), 2)
    state = pretrain.begin(jax.vmap(lambda key: agent.init(key, env, CONFIG))(keys))
    return env, state, jax.jit(lambda state: pretrain.iterate(state, env, CONFIG))


def test_the_best_trial_is_kept_for_each_policy(training):
    env, state, update = training
    state = state.replace(iteration=jnp.array(pretrain.ITERATIONS_BETWEEN_TRIALS - 2, jnp.int32))
    state, metrics = update(state)
    assert np.isneginf(metrics["best_return"]).all()
    # the second policy has had a better moment before
    state = state.replace(best_return=jnp.array([-jnp.inf, 1e6]))
    before = jax.tree.leaves(state.best.actor)
    state, metrics = update(state)
    trial = agent.evaluate(
        jax.random.key(0), env, jax.tree.map(lambda x: x[0], state.agents.learner.actor),
        pretrain.TRIAL_EPISODES,
    )  # fmt: skip
    np.testing.assert_allclose(metrics["best_return"], [trial.mean(), 1e6], rtol=1e-5)
    now, learned = jax.tree.leaves(state.best.actor), jax.tree.leaves(state.agents.learner.actor)
    for kept, new, old in zip(now, learned, before, strict=True):
        np.testing.assert_array_equal(kept[0], new[0])
        np.testing.assert_array_equal(kept[1], old[1])


def test_every_training_ends_with_a_trial():
    for task, updates in pretrain.UPDATES.items():
        assert (
            updates % (pretrain.ITERATIONS_BETWEEN_TRIALS * pretrain.CONFIGS[task].updates_per_iteration) == 0
        )


def test_a_sequence_does_not_go_on_from_other_policies(tmp_path):
    args, config = pretrain.Args(kind="ER"), CONFIG
    sets = [policies.shipped("InvertedPendulum", kind)[0] for kind in policies.KINDS]
    found = [
        pretrain._loop_options(args, tmp_path, "", config, earlier)["identity"]["earlier policies"]
        for earlier in (sets[0], sets[1].select([1]), sets[0])
    ]
    assert found[0] == found[2] != found[1]


def test_er_policies_are_rewarded_for_the_entropy_of_those_before_them(monkeypatch, tmp_path):
    """The pendulum's reward is 1 at every step: what is more in the buffer is the bonus."""
    earlier = small.policy_set(size=3)
    args = pretrain.Args(task="InvertedPendulum", kind="ER", count=3, entropy_coefficient=0.5)
    monkeypatch.setattr(pretrain.policies, "load", lambda path: (earlier, {}))
    seen = []

    def one_iteration(update, state, iterations, **options):
        state, _ = update(state)
        seen.append(np.asarray(state.agents.buffer.rows)[0])
        return state, {}

    monkeypatch.setattr(pretrain.loop, "run", one_iteration)
    config = dataclasses.replace(CONFIG, sac=small.SAC)
    keys = jax.random.split(jax.random.key(0), 3)
    sequence = pretrain._train_er(args, small.env("InvertedPendulum"), config, keys, 1, tmp_path)
    assert sequence.size == 3
    # Policies 1 and 2; the first is the MS set's first, and has been trained without a bonus.
    assert len(seen) == 2
    jax.tree.map(np.testing.assert_array_equal, sequence.select([0]), earlier.select([0]))
    rest = 0.5 * (1.0 + np.log(2.0 * np.pi))
    # 8 random steps, and those of an iteration.
    first = seen[0][:16, 5]
    # The spread of the set's first policy is exp(-1) everywhere.
    np.testing.assert_allclose(first, 1.0 + 0.5 * (-1.0 + rest), rtol=1e-5)
    rows = seen[1][:16]
    own = jax.vmap(sac.policy_entropy, (None, 0))(
        jax.tree.map(lambda x: x[1], sequence.actor), jnp.asarray(rows[:, :4])
    )
    np.testing.assert_allclose(rows[:, 5], 1.0 + 0.25 * (-1.0 + rest + np.asarray(own)), rtol=1e-5)


@pytest.mark.parametrize(("option", "message"), [("count", "--count"), ("updates", "--updates")])
def test_no_policies_and_no_training_are_refused(tmp_path, option, message):
    with pytest.raises(ValueError, match=f"{message} must be at least 1, got 0"):
        pretrain.main(pretrain.Args(out=tmp_path, **{option: 0}))
    assert not list(tmp_path.iterdir())


def test_sets_of_different_coefficients_are_different_files():
    names = [
        pretrain._set_path(pretrain.Args(kind="ER", entropy_coefficient=c), "ER").name for c in (0.1, 0.01)
    ]
    assert names == ["InvertedPendulum-ER.npz", "InvertedPendulum-ER-0.01.npz"]
    assert pretrain._set_path(pretrain.Args(entropy_coefficient=0.01), "MS").name == "InvertedPendulum-MS.npz"
