"""A preset of a few steps, for whole cells in tests, and what a method is given in them."""

import jax
import numpy as np

from experiments.methods import METHODS, Cell
from experiments.methods.cell import Work
from experiments.presets import PlusSettings, Preset, TaskSettings, VineSettings
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.trpo import TRPOConfig
from tests import small

TINY = Preset(
    name="tiny",
    tasks={
        "InvertedPendulum": TaskSettings(
            GroundingConfig(
                num_envs=4,
                steps_per_iteration=8,
                iterations=3,
                transformer=TransformerConfig(hidden=(8,)),
                policy=TRPOConfig(cg_iterations=2),
                discriminator=DiscriminatorConfig(hidden=(8,)),
                discriminator_updates=1,
                discriminator_batch=16,
                value_epochs=1,
                value_minibatch=32,
            ),
            AgentConfig(
                small.SAC,
                num_envs=2,
                steps_per_iteration=4,
                updates_per_iteration=2,
                buffer_capacity=100,
                random_steps=8,
            ),
            agent_updates=6,
        )
    },
    vine=VineSettings(branches=2),
    inversion=InversionConfig(TransformerConfig(hidden=(8,)), iterations=2, epochs=2, minibatch_size=16),
    plus=PlusSettings(iterations=2, stopping=EarlyStop(rows=8)),
    policies=2,
    members=2,
    episodes=2,
)


def work(method: str, folder, seeds=(0,), samples=12, **more) -> Work:
    """What a method is given on SkewedPendulum, from small untrained policies."""
    several = [jax.tree.map(lambda x: x[:2], small.policy_set()) for _ in seeds]
    return Work(
        cell=Cell("SkewedPendulum", method, samples, seeds, TINY, "c", "mujoco"),
        method=METHODS[method],
        source=small.env("InvertedPendulum"),
        target=small.env("SkewedPendulum"),
        sets=small.stacked(*several),
        folder=folder,
        quiet=True,
        **{"logs": None, **more},
    )


def assert_moves_like(state, change: float) -> None:
    """The first steps in the buffer are those of the simulator under actions that are `change` higher, clipped."""
    rows = np.asarray(state.buffer.rows)[0, :8]
    observation, action, following = rows[:, :4], rows[:, 4:5], rows[:, 6:10]
    executed = np.clip(action + change, -3.0, 3.0)
    reached = small.step_from("InvertedPendulum", observation, executed)
    np.testing.assert_allclose(following, reached, atol=2e-5)
