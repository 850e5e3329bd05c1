"""Frozen configurations: `quick` (minutes), `standard` (hours on two cores), `paper` (its text), `release` (its code).

All methods of a preset share its budgets. `SPG`, `MPG` and `MPGE` have the paper's structure in every preset; where a
preset's numbers follow the paper or its authors' code and where they do not is listed fact by fact in
docs/presets.md, which `python -m experiments.facts` writes. `quick` and `standard` were tuned on tasks that no table
shows (`experiments.tuning`, docs/tuning.md) and are frozen.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import SACConfig
from mpge_jax.learning.trpo import TRPOConfig
from mpge_jax.rollouts import policies


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
class VineSettings:
    """How the grounding of `Vine` differs from the paper's (docs/grounding.md), at the same batch.

    Attributes:
      branches: draws of pi_g at each state.
      max_kl: TRPO's trust region.
      learning_rate, penalty_coefficient: of D, which judges s' less the simulator's own step.
      memory: share of the run that the average of the iterates reaches back over.
    """

    branches: int = 8
    max_kl: float = 0.03
    learning_rate: float = 1e-3
    penalty_coefficient: float = 5.0
    memory: float = 0.05

    def grounding(self, base: GroundingConfig) -> GroundingConfig:
        """The grounding configuration of `Vine` where the paper's structure has `base`.

        Raises:
          ValueError: the steps of an iteration cannot be divided by the branches.
        """
        if base.steps_per_iteration % self.branches:
            raise ValueError(
                f"Vine: {base.steps_per_iteration} steps an iteration cannot be divided into {self.branches} branches"
            )
        return replace(
            base,
            steps_per_iteration=base.steps_per_iteration // self.branches,
            branches=self.branches,
            policy=TRPOConfig(max_kl=self.max_kl),
            discriminator=replace(
                base.discriminator,
                next_as="residual",
                learning_rate=self.learning_rate,
                penalty_coefficient=self.penalty_coefficient,
            ),
            averaging=max(0.0, 1.0 - 1.0 / (self.memory * base.iterations)),
        )


@dataclass(frozen=True)
class PlusSettings:
    """How the adversarial stage of `MPGE+` differs from the grounding of `Vine`.

    Attributes:
      iterations: outer iterations after the inversion, at most.
      restart_steps: length of the episodes, which start in logged states.
      log_std: where the spread starts, as narrow as the inversion is good.
      max_kl: TRPO's trust region.
      stopping: rows kept back, by which the stage ends and its best moment, the inversion among them, is kept.
    """

    iterations: int = 100
    restart_steps: int = 2
    log_std: float = -3.0
    max_kl: float = 1e-3
    stopping: EarlyStop = field(default_factory=EarlyStop)

    def grounding(self, base: GroundingConfig) -> GroundingConfig:
        """The grounding configuration of `MPGE+` where `Vine` has `base`."""
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
      vine: of `Vine`, and of the adversarial stage of `MPGE+`.
      inversion: of `GAT`, and of the start of `MPGE+`.
      plus: of `MPGE+`.
      entropy_coefficient: of the ER set of rollout policies.
      policies: rollout policies of a set, K (SPG has one).
      members: transformers of an ensemble, N.
      episodes: of an evaluation in the target, as many deterministic as stochastic.
    """

    name: str
    tasks: Mapping[str, TaskSettings]
    vine: VineSettings = field(default_factory=VineSettings)
    inversion: InversionConfig = field(default_factory=InversionConfig)
    plus: PlusSettings = field(default_factory=PlusSettings)
    entropy_coefficient: float = policies.ER_COEFFICIENT
    policies: int = 5
    members: int = 5
    episodes: int = 50

    def with_task(self, source: str) -> "Preset":
        """This preset with settings for a task of the user's own: those of Hopper, if it has any, else its first."""
        if source in self.tasks:
            return self
        like = self.tasks.get("Hopper") or next(iter(self.tasks.values()))
        return replace(self, tasks={**self.tasks, source: like})


# Four fresh transitions an update, small batches, higher learning rates: chosen on the source tasks.
_FAST_SAC = SACConfig(actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-3, batch_size=128)


def _fast_agent(updates: int, random_steps: int) -> AgentConfig:
    steps = random_steps + 4 * updates + 2_048
    return AgentConfig(sac=_FAST_SAC, buffer_capacity=steps, random_steps=random_steps)


def _fast(iterations: int, log_std: float, judged: int, updates: int, random_steps: int) -> TaskSettings:
    """`judged` updates of D an iteration, `updates` of the agent in all."""
    grounding = GroundingConfig(
        iterations=iterations,
        transformer=TransformerConfig(init_log_std=log_std),
        policy=TRPOConfig(max_kl=0.03),
        discriminator=DiscriminatorConfig(learning_rate=1e-3),
        discriminator_updates=judged,
    )
    return TaskSettings(grounding, _fast_agent(updates, random_steps), updates)


def _paper_agent(random_steps: int) -> AgentConfig:
    return AgentConfig(
        num_envs=1,
        steps_per_iteration=256,
        updates_per_iteration=256,
        # One update after every step, as in Stable-Baselines3, the paper's agent.
        alternations=256,
        random_steps=random_steps,
        buffer_capacity=1_000_000,
    )


def _paper(grounding: GroundingConfig, steps: Mapping[str, int]) -> dict[str, TaskSettings]:
    """Grounding for so many simulator `steps`; agents for 3M steps, the random ones included, 2M on the pendulum."""

    def of(task: str) -> GroundingConfig:
        return replace(grounding, iterations=-(-steps[task] // grounding.simulator_steps))

    return {
        # The pendulum's values learn slower.
        "InvertedPendulum": TaskSettings(
            replace(of("InvertedPendulum"), value_learning_rate=3e-4),
            _paper_agent(1_000),
            2_000_000 - 1_000,
        ),
        "Hopper": TaskSettings(of("Hopper"), _paper_agent(1_000), 3_000_000 - 1_000),
        "HalfCheetah": TaskSettings(of("HalfCheetah"), _paper_agent(10_000), 3_000_000 - 10_000),
    }


QUICK = Preset(
    name="quick",
    tasks={
        "InvertedPendulum": _fast(100, -0.5, 24, 3_072, 1_000),
        "Hopper": _fast(150, -1.5, 12, 5_120, 1_000),
        "HalfCheetah": _fast(150, -1.5, 12, 5_120, 10_000),
    },
    inversion=InversionConfig(epochs=200),
    plus=PlusSettings(iterations=40),
)

STANDARD = Preset(
    name="standard",
    tasks={
        "InvertedPendulum": _fast(200, -0.5, 24, 6_144, 1_000),
        "Hopper": _fast(500, -1.5, 12, 30_720, 1_000),
        "HalfCheetah": _fast(1000, -1.5, 12, 30_720, 10_000),
    },
)

PAPER = Preset(
    name="paper",
    tasks=_paper(
        GroundingConfig(
            num_envs=1,
            steps_per_iteration=2048,
            discriminator_updates=4,
            discriminator_batch=512,
        ),
        {"InvertedPendulum": 5_000_000, "Hopper": 20_000_000, "HalfCheetah": 20_000_000},
    ),
)

RELEASE = Preset(
    name="release",
    tasks=_paper(
        GroundingConfig(
            num_envs=1,
            steps_per_iteration=2048,
            discriminator=DiscriminatorConfig(labels="release", interpolation="constant"),
            discriminator_updates=8,
            discriminator_batch=256,
            discriminator_first=False,
            value_heads="one_hot",
        ),
        dict.fromkeys(("InvertedPendulum", "Hopper", "HalfCheetah"), 20_000_000),
    ),
    entropy_coefficient=0.01,
)

PRESETS = {preset.name: preset for preset in (QUICK, STANDARD, PAPER, RELEASE)}
