"""Target logs: every step is metered, rows are true transitions, and bad files and logs are named."""

import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.c_engine import CEngine
from mpge_jax.learning import sac
from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.target_log import TargetLog
from tests import small


@pytest.fixture
def stepped(monkeypatch):
    """How many environment steps the engine really takes, call by call."""
    sizes = []
    original = CEngine._step

    def counted(self, given, *rest):
        sizes.append(int(np.prod(given[0].shape[:-1], dtype=int)))
        return original(self, given, *rest)

    monkeypatch.setattr(CEngine, "_step", counted)
    return sizes


def valid(log: TargetLog, name: str, k: int) -> np.ndarray:
    return np.asarray(getattr(log, name))[k, : int(log.count[k])]


@pytest.mark.parametrize(
    ("budget", "counts"), [(3, [1, 1, 1]), (30, [10, 10, 10]), (32, [11, 11, 10])], ids=str
)
def test_a_budget_is_taken_to_the_step(stepped, budget, counts):
    # Episodes of these policies end after about ten steps: resets take no step of the engine.
    env, policies = small.env("SkewedPendulum"), small.policy_set()
    log = target_log.collect(jax.random.key(0), env, policies.rollout, budget)
    jax.block_until_ready(log)
    assert sum(stepped) == budget
    assert log.steps == budget
    assert np.asarray(log.count).tolist() == counts
    target_log.validate(log, env)


def test_a_budget_below_one_step_a_policy_is_refused(stepped):
    with pytest.raises(
        ValueError, match="budget of 2 target steps is smaller than the number of rollout policies, 3"
    ):
        target_log.collect(jax.random.key(0), small.env("SkewedPendulum"), small.policy_set().rollout, 2)
    assert stepped == []


def test_policies_of_another_task_are_refused(stepped):
    with pytest.raises(
        ValueError, match="these rollout policies cannot act on the 17 observations of BrokenCheetah"
    ):
        target_log.collect(jax.random.key(0), small.env("BrokenCheetah"), small.policy_set().rollout, 30)
    assert stepped == []


def test_rows_are_transitions_of_the_target():
    log = small.log()
    rows = log.rows()
    assert {name: len(x) for name, x in rows.items()} == dict.fromkeys(rows, log.steps)
    reached = small.step_from("SkewedPendulum", rows["observation"], rows["action"])
    np.testing.assert_allclose(rows["next_observation"], reached, atol=2e-5)
    # A row shifted by one would not pass.
    assert np.abs(rows["next_observation"][1:] - reached[:-1]).max() > 0.1


def test_an_episode_ends_in_the_state_it_truly_reached():
    log = small.log()
    ends = 0
    for k in range(3):
        observation, following = valid(log, "observation", k), valid(log, "next_observation", k)
        terminated, episode = valid(log, "terminated", k), valid(log, "episode", k)
        # The pendulum's episodes end beyond 0.2 rad and start within 0.01.
        np.testing.assert_array_equal(terminated > 0, np.abs(following[:, 1]) > 0.2)
        over = terminated[:-1] > 0
        np.testing.assert_array_equal(observation[1:][~over], following[:-1][~over])
        assert np.abs(observation[1:][over]).max() <= 0.01
        np.testing.assert_array_equal(episode, np.cumsum(np.concatenate([[False], over])))
        ends += int(over.sum())
    assert ends >= 3


def test_each_policy_has_its_own_log():
    log, policies = small.log(log_std=-18.0), small.policy_set(log_std=-18.0)
    for k in range(3):
        actor = jax.tree.map(lambda x, k=k: x[k], policies.actor)
        asked = sac.act(actor, jnp.asarray(valid(log, "observation", k)))
        np.testing.assert_allclose(valid(log, "action", k), asked, atol=1e-4)


def test_actions_are_drawn_not_the_mode():
    log, policies = small.log(), small.policy_set()
    actor = jax.tree.map(lambda x: x[0], policies.actor)
    mode = np.asarray(sac.act(actor, jnp.asarray(valid(log, "observation", 0))))
    assert np.std(valid(log, "action", 0) - mode) > 0.3


def test_a_key_decides_the_log():
    env, policies = small.env("SkewedPendulum"), small.policy_set()
    again = target_log.collect(jax.random.key(5), env, policies.rollout, 40)
    other = target_log.collect(jax.random.key(6), env, policies.rollout, 40)
    jax.tree.map(np.testing.assert_array_equal, again, small.log())
    assert not np.array_equal(other.action, again.action)


def test_save_and_load_give_the_same_log(tmp_path):
    path = tmp_path / "new" / "log.npz"
    target_log.save(path, small.log())
    loaded = target_log.load(path)
    jax.tree.map(np.testing.assert_array_equal, loaded, small.log())
    assert [x.dtype for x in jax.tree.leaves(loaded)] == [x.dtype for x in jax.tree.leaves(small.log())]
    assert [p.name for p in path.parent.iterdir()] == ["log.npz"]
    target_log.validate(loaded, small.env("SkewedPendulum"))


def truncated(path):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def without_counts(path):
    with np.load(path) as file:
        np.savez(path, **{name: file[name] for name in file.files if name != "count"})


def npy():
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


def with_pickle(path):
    with np.load(path) as file:
        fields = {name: file[name] for name in file.files}
    np.savez(path, **{**fields, "action": np.array([{"a": 1}], dtype=object)})


@pytest.mark.parametrize(
    "damage",
    [
        truncated,
        without_counts,
        with_pickle,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("no log"),
        lambda path: path.write_bytes(npy()),
    ],
    ids=["truncated", "field missing", "pickle", "empty", "text", "npy"],
)
def test_a_damaged_file_is_named_in_one_sentence(tmp_path, damage):
    path = tmp_path / "log.npz"
    target_log.save(path, small.log())
    damage(path)
    with pytest.raises(ValueError, match=r"log\.npz is damaged or is not a target log") as error:
        target_log.load(path)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no target log at .*nowhere\.npz"):
        target_log.load(tmp_path / "nowhere.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda log: log.replace(action=log.action.at[1, 3].set(jnp.nan)),
            "action of policy 1 is not finite in row 3",
        ),
        (
            lambda log: log.replace(next_observation=log.next_observation.at[0, 0, 2].set(jnp.inf)),
            "next_observation of policy 0 is not finite in row 0",
        ),
        (
            lambda log: log.replace(count=log.count.at[2].set(0)),
            "every rollout policy needs at least one transition",
        ),
        (
            lambda log: jax.tree.map(lambda x: x[:0], log),
            "every rollout policy needs at least one transition",
        ),
        (lambda log: log.replace(count=log.count + 1), "count says 15 rows, but there are 14"),
        (
            lambda log: log.replace(action=log.action[..., 0]),
            r"action has shape \(3, 14\), SkewedPendulum needs",
        ),
        (lambda log: log.replace(episode=log.episode[:2]), r"episode has shape \(2, 14\)"),
        (lambda log: jax.tree.map(lambda x: x[0], log), r"need shapes \[K\] and \[K, M, O\]"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused(change, message):
    with pytest.raises(ValueError, match=message) as error:
        target_log.validate(change(small.log()), small.env("SkewedPendulum"))
    assert "\n" not in str(error.value)


def test_what_padding_holds_does_not_matter():
    log = small.log(steps=40)
    padding = np.arange(log.observation.shape[1])[None] >= np.asarray(log.count)[:, None]
    assert padding.any()
    target_log.validate(
        log.replace(action=jnp.where(padding[..., None], jnp.nan, log.action)), small.env("SkewedPendulum")
    )
