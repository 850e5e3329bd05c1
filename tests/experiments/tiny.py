"""A preset of a few steps, for whole cells in tests."""

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
