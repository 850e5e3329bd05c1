"""What every method of the sweep is handed: policies, logs, keys, simulators and targets."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments import methods
from experiments.methods import METHODS, Cell, baselines, grounded, recording, training
from mpge_jax.grounding import ensemble
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.target_log import TargetLog
from tests import small
from tests.experiments.tiny import TINY, assert_moves_like, work

SEEDS = (0, 1, 2)
SAMPLES = 12
GROUNDING = [name for name, method in METHODS.items() if method.work is grounded.grounded]


def cell(method: str) -> Cell:
    return Cell("SkewedPendulum", method, SAMPLES, SEEDS, TINY, "c", "mujoco")


@pytest.fixture
def handed(monkeypatch, tmp_path):
    """Runs a cell of which nothing is computed; what each stage was given."""
    given: dict = {}
    monkeypatch.setattr(
        policies,
        "shipped",
        lambda task, kind, coefficient: (
            small.policy_set(task, size=4, seed=len(kind)),
            {"entropy_coefficient": coefficient if kind == "ER" else 0.0},
        ),
    )

    def record(key, env, rollout, budget):
        given.setdefault("targets", []).append(env.name)
        count = jnp.full(rollout.size, budget // rollout.size, jnp.int32)
        row = jnp.zeros((rollout.size, budget))
        mark = jnp.zeros((rollout.size, budget, 4)) + jax.random.uniform(key)
        return TargetLog(mark, row[..., None], mark, row, row.astype(int), count)

    def transformers(keys):
        return jax.vmap(lambda _: small.constant(small.env("InvertedPendulum"), 1.5))(jnp.arange(keys.size))

    def ground(env, rollout, logs, config, keys, **options):
        given["ground"] = {
            "env": env, "rollout": rollout, "logs": logs, "config": config, "keys": keys, **options
        }  # fmt: skip
        zeros = np.zeros((config.iterations, keys.shape[0]))
        return transformers(keys), {"reward": zeros, "error_uniform": zeros}

    def invert(env, logs, config, keys):
        given["invert"] = {"env": env, "logs": logs, "config": config, "keys": keys}
        made = jax.tree.map(lambda x: x.reshape(*keys.shape, *x.shape[1:]), transformers(keys))
        return made, jnp.zeros(keys.shape[0])

    def train(work, env_of, transformers):
        given["train"] = {"env_of": env_of, "sets": work.sets, "transformers": transformers}
        return training.first_learners(work)

    monkeypatch.setattr(target_log, "collect", record)
    monkeypatch.setattr(ensemble, "ground_ensemble", ground)
    monkeypatch.setattr(ensemble, "invert_ensemble", invert)
    monkeypatch.setattr(grounded, "train", train)
    monkeypatch.setattr(baselines, "train", lambda work, env_of: training.first_learners(work))
    monkeypatch.setattr(
        training, "evaluate", lambda cell, target, agents: {"return_stochastic": np.zeros((3, 2))}
    )
    monkeypatch.setattr(grounded, "errors", lambda work, made: [{} for _ in SEEDS])

    def run(method: str):
        given.clear()
        given["outcome"] = methods.run(cell(method), tmp_path / method)
        return given

    return run


def biases(tree) -> np.ndarray:
    """Tells policies apart: the mean action of each, `[..., K]`."""
    return np.asarray(tree.params["params"]["Dense_1"]["bias"])[..., 0]


@pytest.mark.parametrize("name", GROUNDING)
def test_a_grounding_method_gets_its_policies_its_logs_and_keys_of_its_own(handed, name):
    method, given = METHODS[name], handed(name)
    assert set(given["targets"]) == {"SkewedPendulum"}
    size, members = (
        (TINY.policies if method.several_policies else 1),
        (TINY.members if method.ensemble else 1),
    )
    stage = given.get("ground") or given["invert"]
    assert stage["env"].name == "InvertedPendulum"
    # Of the four policies of the set of its kind, experiment i has i, i + 1, ...
    whole = biases(small.policy_set("InvertedPendulum", size=4, seed=len(method.kind)).actor)
    wanted = np.stack([whole[[(i + k) % 4 for k in range(size)]] for i in SEEDS])
    sets = given["train"]["sets"]
    np.testing.assert_array_equal(biases(sets.actor), wanted)
    if "ground" in given:
        np.testing.assert_array_equal(biases(stage["rollout"].params), np.repeat(wanted, members, axis=0))
        logs = np.asarray(stage["logs"].observation)[:, 0, 0, 0]
        assert logs.shape == (3 * members,)
        # One log an experiment, shared by its members.
        np.testing.assert_array_equal(logs, np.repeat(logs[::members], members))
        assert len(set(logs)) == 3
    keys = np.asarray(jax.random.key_data(stage["keys"])).reshape(3 * members, -1)
    assert len(np.unique(keys, axis=0)) == 3 * members
    shape = jax.tree.leaves(given["train"]["transformers"])[0].shape[:2]
    assert shape == (3, members)


@pytest.mark.parametrize("name", GROUNDING)
def test_a_grounding_method_grounds_as_its_structure_says(handed, name):
    given = handed(name)
    if name == "GAT":
        assert "ground" not in given
        return
    stage = given["ground"]
    assert stage["config"] == methods.grounding_config(METHODS[name], TINY, "InvertedPendulum")
    assert (stage["config"].branches > 1) == (name in ("Vine", "MPGE+"))
    assert ("invert" in given) == (name == "MPGE+") == (stage["start"] is not None)
    assert stage["stopping"] == (TINY.plus.stopping if name == "MPGE+" else None)
    if name == "MPGE+":
        np.testing.assert_array_equal(stage["start"].params["log_std"], np.full((6, 1), -3.0))
        # Its inversion does not see the rows that judge it.
        assert isinstance(stage["stopping"], EarlyStop)
        assert int(np.sum(given["invert"]["logs"].count)) < int(np.sum(stage["logs"].count))


def test_simulator_steps_and_target_steps_are_all_counted(handed):
    rows = {
        name: handed(name)["outcome"].rows for name in ("direct", "SPG", "MPGE-MS", "Vine", "GAT", "target")
    }
    assert {row["target_steps"] for name in ("SPG", "MPGE-MS", "Vine", "GAT") for row in rows[name]} == {12}
    # 3 iterations of 4 environments and 8 steps.
    assert rows["SPG"][0]["grounding_simulator_steps"] == 3 * 32
    assert rows["MPGE-MS"][0]["grounding_simulator_steps"] == 2 * 3 * 32
    # With 2 branches of 4 steps: 16 states more an iteration, and the log's 12 rows once.
    assert rows["Vine"][0]["grounding_simulator_steps"] == 2 * (3 * (32 + 16) + 12)
    # 2 iterations of one difference and one try, after the first.
    assert rows["GAT"][0]["grounding_simulator_steps"] == 12 * (1 + 2 * 2)
    # 8 random steps; 6 updates are 3 iterations of 2 environments and 4 steps.
    assert [row["target_steps"] for row in rows["target"]] == [8 + 3 * 8] * 3
    assert [row["target_steps"] for row in rows["direct"]] == [0] * 3


def test_an_er_set_of_another_coefficient_is_refused(monkeypatch):
    monkeypatch.setattr(
        policies,
        "shipped",
        lambda task, kind, coefficient: (small.policy_set(), {"entropy_coefficient": 0.1}),
    )
    other = dataclasses.replace(TINY, entropy_coefficient=0.01)
    with pytest.raises(ValueError, match=r"made with an entropy coefficient of 0.1, preset tiny wants 0.01"):
        recording.policy_set("InvertedPendulum", "ER", other)
    assert recording.policy_set("InvertedPendulum", "MS", other).size == 3


def test_agents_train_behind_the_transformers_and_in_the_target_only_where_asked(
    monkeypatch, tmp_path, begun
):
    pushed = jax.tree.map(lambda x: x[None, None], small.constant(small.env("InvertedPendulum"), -1.0))
    monkeypatch.setattr(grounded, "ground", lambda work: (pushed, {}, [0]))
    monkeypatch.setattr(grounded, "errors", lambda work, made: [{}])
    log = small.stacked(small.log(size=2))
    for name, change in (("SPG", -1.0), ("target", 1.5)):
        given = work(name, tmp_path, logs=log)
        METHODS[name].work(given)
        assert_moves_like(begun[-1], change)
        # It starts from the experiment's own policy, the first of the set.
        np.testing.assert_array_equal(
            begun[-1].learner.actor.params["params"]["Dense_1"]["bias"][0],
            given.sets.actor.params["params"]["Dense_1"]["bias"][0, 0],
        )


def test_direct_does_not_train(tmp_path):
    given = work("direct", tmp_path)
    learners = METHODS["direct"].work(given).learners
    jax.tree.map(
        np.testing.assert_array_equal, learners.actor, jax.tree.map(lambda x: x[:, 0], given.sets.actor)
    )
