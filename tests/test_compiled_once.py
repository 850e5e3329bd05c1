"""The main steps compile once: what goes in comes out with the same shapes and types, weak ones included.

A state whose numbers are weakly typed at first, and no more after one step, is compiled twice.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mpge_jax
from experiments import pretrain
from mpge_jax.grounding import adversarial, early_stop, ensemble
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.ppo import PPOConfig
from tests import points, small

AGENT = AgentConfig(
    small.SAC, num_envs=2, steps_per_iteration=4, updates_per_iteration=2, buffer_capacity=64, random_steps=4
)
STOP = EarlyStop(rows=4)


def ground(config):
    args = (points.SOURCE, points.policies(), points.log(), config)
    return lambda key: adversarial.init(key, *args), lambda state: adversarial.update(state, *args)[0]


def ground_and_judge():
    log, rows = STOP.hold_out(points.log())
    args = (points.SOURCE, points.policies(), log, points.CONFIG)

    def update(state):
        return early_stop.update(state, adversarial.update(state.grounding, *args)[0], points.SOURCE, rows)[0]

    return lambda key: early_stop.init(adversarial.init(key, *args), points.SOURCE, rows), update


def train():
    return (
        lambda key: agent.init(key, points.SOURCE, AGENT),
        lambda state: agent.iterate(state, points.SOURCE, AGENT)[0],
    )


def pretrain_():
    def init(key):
        return pretrain.begin(jax.vmap(lambda k: agent.init(k, points.SOURCE, AGENT))(key[None]))

    return init, lambda state: pretrain.iterate(state, points.SOURCE, AGENT)[0]


STEPS = {
    "grounding": ground(points.CONFIG),
    "grounding, one-hot values, PPO": ground(
        dataclasses.replace(points.CONFIG, value_heads="one_hot", policy=PPOConfig(minibatch_size=8))
    ),
    "grounding, branches": ground(dataclasses.replace(points.CONFIG, branches=2)),
    "grounding with early stop": ground_and_judge(),
    "agent": train(),
    "pretraining": pretrain_(),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_state_keeps_its_types(name):
    init, update = STEPS[name]
    before = jax.eval_shape(init, jax.random.key(0))
    after = jax.eval_shape(update, before)
    assert jax.tree.structure(before) == jax.tree.structure(after)
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(before)]
    for path, a, b in zip(paths, jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (a.shape, a.dtype, a.weak_type) == (b.shape, b.dtype, b.weak_type), path
        assert not a.weak_type, path


def test_a_weak_type_would_be_seen():
    assert jax.eval_shape(lambda: jnp.full(2, 0.5)).weak_type
    assert not jax.eval_shape(lambda: jnp.full(2, 0.5, jnp.float32)).weak_type


def test_an_ensemble_compiles_its_iteration_once(monkeypatch):
    compiled = []
    original = ensemble.sharding.compile

    def kept(*arguments):
        compiled.append(original(*arguments))
        return compiled[-1]

    monkeypatch.setattr(ensemble.sharding, "compile", kept)
    _, curve = mpge_jax.ground(
        points.SOURCE, points.policies(), points.log(), points.CONFIG, jax.random.key(0), quiet=True
    )
    assert curve["reward"].shape == (3,) and np.isfinite(curve["reward"]).all()
    (step,) = compiled
    assert step._cache_size() == 1
