"""Shapes are in the signatures and checked at every call of a test; see `tests/shape_checks.py`."""

import dataclasses
import importlib
import inspect
import typing
from functools import partial

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import optax
import pytest
from beartype.door import is_bearable
from flax import struct

from mpge_jax.grounding import (
    adversarial,
    collect,
    discriminator,
    early_stop,
    inversion,
    prediction,
    transformer,
)
from mpge_jax.grounding.discriminator import DiscriminatorConfig, Transitions
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.learning import agent, buffer, distributions, normalise, ppo, sac, value
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.value import ValueConfig
from mpge_jax.rollouts import policies
from tests import points, small
from tests.learning import bandit
from tests.shape_checks import MODULES

KEY = jax.random.key(0)
D, V = DiscriminatorConfig(hidden=(4,)), ValueConfig(policies=2, hidden=(4,))
ROWS = Transitions(jnp.zeros((5, 3)), jnp.zeros((5, 2)), jnp.zeros((5, 3)))
flat = partial(jnp.zeros, 5)


def q_values(action):
    learner = sac.init(KEY, 3, 2, np.ones(2, np.float32), small.SAC)
    return sac.q_values(learner.critic, jnp.zeros((5, 3)), action, small.SAC)


WRONG = {
    "transformer.transform": lambda: transformer.transform(
        jnp.zeros((5, 2)), jnp.zeros((5, 2)), jnp.zeros(3), jnp.ones(2)
    ),
    "discriminator.reward": lambda: discriminator.reward(ROWS, discriminator.init(KEY, 3, 2, D), D),
    "discriminator.reward_from_logits": lambda: discriminator.reward_from_logits(flat(int)),
    "value.update": lambda: value.update(
        value.init(KEY, 3, V), jnp.zeros((5, 3)), flat(int), jnp.zeros((5, 1)), KEY, V
    ),
    "value.predict": lambda: value.predict(value.init(KEY, 3, V).params, jnp.zeros((5, 3)), flat(), V),
    "distributions.gaussian_log_prob": lambda: distributions.gaussian_log_prob(
        jnp.zeros((5, 2)), jnp.zeros((5, 2)), jnp.zeros(2)
    ),
    "normalise.update": lambda: normalise.update(normalise.init(5), flat()),
    "ppo.clipped_objective": lambda: ppo.clipped_objective(flat(), jnp.zeros((5, 1)), 0.2),
    "policies.mean_entropy": lambda: policies.mean_entropy(
        small.policy_set(), jnp.ones((3, 1)), jnp.zeros(4)
    ),
    "sac.q_values": lambda: q_values(jnp.zeros((6, 2))),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_shape_or_type_is_refused_by_the_function_it_was_given_to(name):
    with pytest.raises(jaxtyping.TypeCheckError, match=rf"the parameters of mpge_jax\.\w+\.{name}\.\n"):
        WRONG[name]()


def functions(module):
    """Functions, methods and properties that are written in `module`."""
    for thing in vars(module).values():
        if getattr(thing, "__module__", None) != module.__name__:
            continue
        for member in vars(thing).values() if inspect.isclass(thing) else [thing]:
            member = member.fget if isinstance(member, property) else member
            own = inspect.isfunction(member) and member.__module__ == module.__name__
            if own and not member.__name__.startswith("__"):
                yield member


def without_shape(hint):
    if hint in (jax.Array, np.ndarray, jax.typing.ArrayLike):
        return True
    return any(map(without_shape, hint if isinstance(hint, list) else typing.get_args(hint)))


@pytest.mark.parametrize("name", MODULES)
def test_every_signature_says_what_it_takes_and_gives_and_is_checked(name):
    module = importlib.import_module(name)
    for function in functions(module):
        signature, hints = inspect.signature(function), typing.get_type_hints(function)
        wanted = {"return", *signature.parameters} - {"self"}
        assert wanted <= set(hints), f"{name}.{function.__qualname__} leaves {wanted - set(hints)} open"
        arrays = [argument for argument, hint in hints.items() if without_shape(hint)]
        assert not arrays, f"{name}.{function.__qualname__}: which shapes have {arrays}?"
        assert hasattr(function, "__wrapped__"), f"{name} was imported before the hook"


def check_fields(node):
    """Makes sure that every state in `node` is what its fields say."""
    for child in jax.tree.leaves(node, is_leaf=lambda x: x is not node and isinstance(x, struct.PyTreeNode)):
        if isinstance(child, struct.PyTreeNode):
            check_fields(child)
    if type(node).__module__ not in MODULES:
        return
    hints = inspect.get_annotations(type(node))
    with jaxtyping.jaxtyped("context"):
        for field in dataclasses.fields(node):
            found, hint = getattr(node, field.name), hints[field.name]
            # The state of an optimiser is optax's affair.
            if hint is not optax.OptState and (without_shape(hint) or not is_bearable(found, hint)):
                shapes = jax.tree.map(jnp.shape, found)
                raise TypeError(f"{type(node).__name__}.{field.name} is {shapes}, and {hint} by its class")


AGENT = AgentConfig(
    small.SAC, num_envs=2, steps_per_iteration=4, updates_per_iteration=2, buffer_capacity=64, random_steps=4
)
GROUNDING = dataclasses.replace(
    points.CONFIG, discriminator=dataclasses.replace(points.CONFIG.discriminator, next_as="residual")
)


def grounded(key):
    """All states of a grounding, one iteration in."""
    log, rows = EarlyStop(rows=4).hold_out(points.log())
    args = (points.SOURCE, points.policies(), log, GROUNDING)
    first = adversarial.init(key, *args)
    _, drawn = collect.collect(
        key, first.current, (first.env_state, first.rollout_policy), args[0], args[1], log, GROUNDING
    )
    second, _ = adversarial.update(first, *args)
    judged = early_stop.init(first, points.SOURCE, rows)
    return judged, early_stop.update(judged, second, points.SOURCE, rows)[0], drawn, log, rows


def trained(key):
    """All states of an agent, one iteration in."""
    state, _ = agent.iterate(agent.init(key, points.SOURCE, AGENT), points.SOURCE, AGENT)
    learners = jax.tree.map(lambda x: x[None], state.learner)
    return state, buffer.sample(state.buffer, key, 3), policies.from_learners(learners)


def inverted(key):
    del key
    return inversion.invert(points.SOURCE, points.log(), inversion.InversionConfig(iterations=1))


def decided(key):
    return bandit.batch(bandit.policy_params(key), key, 5)


@pytest.mark.parametrize("make", [grounded, trained, inverted, decided])
def test_states_hold_what_their_fields_say(make):
    points.log()
    # Traced, not run: shapes are known without numbers.
    jax.eval_shape(lambda key: check_fields(make(key)), KEY)
    jax.eval_shape(lambda keys: check_fields(jax.vmap(make)(keys)), jax.random.split(KEY, 2))


def test_a_field_that_is_not_what_it_says_is_seen():
    _, rows = prediction.hold_out(points.log(), 0.2)
    check_fields(rows)
    with pytest.raises(TypeError, match=r"HeldOut\.weight"):
        check_fields(rows.replace(weight=rows.weight[:, None]))
