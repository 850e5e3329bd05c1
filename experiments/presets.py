"""Frozen configurations: `quick` (minutes), `standard` (hours on two cores), `paper` (its text), `release` (its code).

All methods of a preset share its budgets. `paper` and `release` differ where the paper's text and its authors'
experiments do (which is which is said beside the numbers).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mpge_jax.agent import AgentConfig
from mpge_jax.discriminator import DiscriminatorConfig
from mpge_jax.grounding_config import GroundingConfig
from mpge_jax.inversion import InversionConfig
from mpge_jax.sac import SACConfig
from mpge_jax.transformer import TransformerConfig
from mpge_jax.trpo import TRPOConfig


@dataclass(frozen=True)
class TaskSettings:
    """What depends on the source task.

    Attributes:
      grounding: of SPG, MPG and MPGE.
      agent: of the agent trained in the grounded environments.
      agent_updates: SAC updates of that agent.
    """

    grounding: GroundingConfig
    agent: AgentConfig
    agent_updates: int

    @property
    def agent_iterations(self) -> int:
        """Compiled iterations that make at least `agent_updates`."""
        return -(-self.agent_updates // self.agent.updates_per_iteration)


@dataclass(frozen=True)
class PlusSettings:
    """How the grounding of `MPGE+` differs from that of the other methods.

    Attributes:
      iterations: outer iterations after the inversion.
      restart_steps: length of the episodes, which start in logged states.
      log_std: where the spread starts, as narrow as the inversion is good.
      max_kl: TRPO's trust region.
      held_out: share of every policy's log kept back from learning, to choose between the inversion and what
        adversarial grounding made of it.
    """

    iterations: int = 100
    restart_steps: int = 2
    log_std: float = -3.0
    max_kl: float = 1e-3
    held_out: float = 0.2

    def grounding(self, base: GroundingConfig) -> GroundingConfig:
        """The grounding configuration of `MPGE+`."""
        return replace(
            base,
            iterations=min(self.iterations, base.iterations),
            restart_steps=self.restart_steps,
            transformer=replace(base.transformer, init_log_std=self.log_std),
            policy=TRPOConfig(max_kl=self.max_kl),
        )


@dataclass(frozen=True)
class Preset:
    """One configuration of the whole pipeline.

    Attributes:
      name: as on the command line.
      tasks: settings by source task.
      inversion: of `GAT`, and of the start of `MPGE+`.
      plus: of `MPGE+`.
      policies: rollout policies of a set, K (SPG has one).
      members: transformers of an ensemble, N.
      episodes: of an evaluation in the target, as many deterministic as stochastic.
    """

    name: str
    tasks: Mapping[str, TaskSettings]
    inversion: InversionConfig = field(default_factory=InversionConfig)
    plus: PlusSettings = field(default_factory=PlusSettings)
    policies: int = 5
    members: int = 5
    episodes: int = 50


# Four fresh transitions an update, small batches, higher learning rates: measured on two cores, see docs/results.md.
_FAST_SAC = SACConfig(actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-3, batch_size=128)


def _fast_agent(updates: int, random_steps: int) -> AgentConfig:
    steps = random_steps + 4 * updates + 2_048
    return AgentConfig(sac=_FAST_SAC, buffer_capacity=steps, random_steps=random_steps)


def _fast(iterations: int, log_std: float, updates: int, random_steps: int) -> TaskSettings:
    # Progress goes by updates rather than by steps, so trust-region steps are long, and the iterates averaged. Eight
    # draws of pi_g at each of 256 states: without the noise of a value function every such step counts. D sees what
    # the simulator leaves unexplained, and need not learn its dynamics before it can say what differs.
    grounding = GroundingConfig(
        steps_per_iteration=4,
        branches=8,
        iterations=iterations,
        transformer=TransformerConfig(init_log_std=log_std),
        policy=TRPOConfig(max_kl=0.03),
        discriminator=DiscriminatorConfig(learning_rate=1e-3, penalty_coefficient=5.0, next_as="residual"),
        discriminator_updates=12,
        # The average reaches back over about a twentieth of the run.
        averaging=1.0 - 20.0 / iterations,
    )
    return TaskSettings(grounding, _fast_agent(updates, random_steps), updates)


def _paper_agent(random_steps: int, capacity: int = 1_000_000) -> AgentConfig:
    return AgentConfig(
        num_envs=1,
        steps_per_iteration=256,
        updates_per_iteration=256,
        random_steps=random_steps,
        buffer_capacity=capacity,
    )


def _paper(grounding: GroundingConfig) -> dict[str, TaskSettings]:
    # 3M steps of the agent, 2M on the pendulum, whose values also learn slower (facts 6 and 26). How long grounding
    # runs is not said: 2M steps, where the error of a wide start has levelled off.
    pendulum = replace(grounding, value_learning_rate=3e-4)
    return {
        "InvertedPendulum": TaskSettings(pendulum, _paper_agent(1_000), 2_000_000),
        "Hopper": TaskSettings(grounding, _paper_agent(1_000), 3_000_000),
        "HalfCheetah": TaskSettings(grounding, _paper_agent(10_000), 3_000_000),
    }


QUICK = Preset(
    name="quick",
    tasks={
        "InvertedPendulum": _fast(100, -0.5, 3_072, 1_000),
        "Hopper": _fast(150, -1.5, 5_120, 1_000),
        "HalfCheetah": _fast(150, -1.5, 5_120, 10_000),
    },
    inversion=InversionConfig(epochs=200),
    plus=PlusSettings(iterations=40),
)

STANDARD = Preset(
    name="standard",
    tasks={
        "InvertedPendulum": _fast(200, -0.5, 6_144, 1_000),
        "Hopper": _fast(500, -1.5, 30_720, 1_000),
        "HalfCheetah": _fast(1000, -1.5, 30_720, 10_000),
    },
)

PAPER = Preset(
    name="paper",
    tasks=_paper(
        GroundingConfig(
            num_envs=1,
            steps_per_iteration=2048,
            iterations=1000,
            discriminator_updates=4,
            discriminator_batch=512,
        )
    ),
)

RELEASE = Preset(
    name="release",
    tasks=_paper(
        GroundingConfig(
            num_envs=1,
            steps_per_iteration=2048,
            iterations=1000,
            discriminator=DiscriminatorConfig(labels="release", interpolation="constant"),
            discriminator_updates=8,
            discriminator_batch=256,
            discriminator_first=False,
            value_heads="one_hot",
        )
    ),
)

PRESETS = {preset.name: preset for preset in (QUICK, STANDARD, PAPER, RELEASE)}
