"""How action transformers are learned: the configuration of `mpge_jax.grounding.adversarial`."""

from dataclasses import dataclass, field
from numbers import Integral
from typing import Literal

from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.ppo import PPOConfig
from mpge_jax.learning.trpo import TRPOConfig
from mpge_jax.learning.value import ValueConfig


@dataclass(frozen=True)
class GroundingConfig:
    """How a transformer is learned; the defaults are the paper's.

    Attributes:
      num_envs: parallel copies of the simulator, B.
      steps_per_iteration: steps of each in one iteration, T; B * T * J is the batch of one policy update.
      branches: draws of pi_g at every state, J; each is simulated one step and the first is followed. 1 in the paper.
        Beyond 1 (this project's `Vine`): the "vine" of TRPO (Schulman et al., 2015, section 5.2), exact here because
        gamma = 0: the baseline of a draw is the mean reward of its siblings, which no error of a value function
        blurs, and the values are not learned.
      iterations: outer iterations.
      transformer: the policy pi_g.
      policy: how it is updated.
      discriminator: D.
      discriminator_updates: gradient steps on D in one iteration.
      discriminator_batch: grounded rows, and as many target rows, of one such step.
      discriminator_first: D before pi_g (Algorithm 1), or after (the release, whose reward is older by one update).
      value_heads, value_learning_rate, value_epochs, value_minibatch: the K value functions.
      restart_steps: 0 starts episodes as the task does, and they last as long as the task lets them; a number starts
        them in states of the target log and ends them after so many steps (this project's addition).
      averaging: decay, an iteration, of the running average of pi_g's parameters that is the result; 0 takes the last
        iterate. A trust-region step has one length however small the gradient, so the iterates end in a random walk
        around the optimum, which the average does not. (0 in the paper.)
    """

    num_envs: int = 64
    steps_per_iteration: int = 32
    branches: int = 1
    iterations: int = 1000
    transformer: TransformerConfig = field(default_factory=TransformerConfig)
    policy: TRPOConfig | PPOConfig = field(default_factory=TRPOConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)
    discriminator_updates: int = 8
    discriminator_batch: int = 256
    discriminator_first: bool = True
    value_heads: Literal["separate", "one_hot"] = "separate"
    value_learning_rate: float = 1e-3
    value_epochs: int = 5
    value_minibatch: int = 128
    restart_steps: int = 0
    averaging: float = 0.0

    def __post_init__(self) -> None:
        names = (
            "num_envs",
            "steps_per_iteration",
            "branches",
            "iterations",
            "discriminator_updates",
            "discriminator_batch",
        )
        for name in (*names, "restart_steps", "value_epochs", "value_minibatch"):
            if not isinstance(getattr(self, name), Integral):
                raise ValueError(
                    f"GroundingConfig: {name} must be a whole number, got {getattr(self, name)!r}."
                )
        for name in names:
            if getattr(self, name) < 1:
                raise ValueError(f"GroundingConfig: {name} must be at least 1, got {getattr(self, name)}.")
        if self.restart_steps < 0:
            raise ValueError(
                f"GroundingConfig: restart_steps must not be negative, got {self.restart_steps}."
            )
        if not 0.0 <= self.averaging < 1.0:
            raise ValueError(f"GroundingConfig: averaging must lie in [0, 1), got {self.averaging}.")
        if self.value_minibatch > self.batch_size:
            raise ValueError(
                f"GroundingConfig: value_minibatch of {self.value_minibatch} exceeds the batch of {self.batch_size}."
            )

    @property
    def batch_size(self) -> int:
        """Transitions that one policy update learns from, B * T * J."""
        return self.num_envs * self.steps_per_iteration * self.branches

    @property
    def simulator_steps(self) -> int:
        """Simulator steps of one iteration: the batch, and where D asks for it one more at every state."""
        return self.num_envs * self.steps_per_iteration * (self.branches + self.needs_expected)

    @property
    def needs_expected(self) -> bool:
        """Whether D wants to know where the untouched simulator goes."""
        return self.discriminator.next_as == "residual"

    def value(self, policies: int) -> ValueConfig:
        """Configuration of the value functions of `policies` rollout policies."""
        return ValueConfig(
            policies,
            heads=self.value_heads,
            learning_rate=self.value_learning_rate,
            epochs=self.value_epochs,
            minibatch_size=self.value_minibatch,
        )
