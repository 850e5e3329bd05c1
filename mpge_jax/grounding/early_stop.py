"""Grounding that stops where rows of the target log kept back are predicted no better, and returns the best so far.

pi_g is judged after every iteration by `prediction.one_step_error` on rows that nothing learns from, from the target's
metered budget: no further target step is taken. Asks that observations determine states.
"""

from dataclasses import dataclass

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from envs import Env, select
from mpge_jax.grounding import prediction
from mpge_jax.grounding.adversarial import GroundingState
from mpge_jax.grounding.prediction import HeldOut
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning.policy_gradient import Metrics, Params
from mpge_jax.rollouts.target_log import TargetLog


@dataclass(frozen=True)
class EarlyStop:
    """When to stop.

    Attributes:
      share: of every policy's rows, the last ones, that are kept back.
      rows: at most so many of them judge, spread evenly.
      patience: iterations without a better one before a member is done; the run ends when all are.
    """

    share: float = 0.2
    rows: int = 256
    patience: int = 20

    def __post_init__(self) -> None:
        if not 0.0 < self.share < 1.0:
            raise ValueError(f"EarlyStop: share must lie in (0, 1), got {self.share}.")
        for name in ("rows", "patience"):
            if getattr(self, name) < 1:
                raise ValueError(f"EarlyStop: {name} must be at least 1, got {getattr(self, name)}.")

    def hold_out(self, log: TargetLog) -> tuple[TargetLog, HeldOut]:
        """The log to learn from, and the rows that judge."""
        return prediction.hold_out(log, self.share, self.rows)

    def is_over(self, metrics: dict[str, Shaped[np.ndarray, "*n"]]) -> bool:
        """Whether no member of the run has become better for `patience` iterations."""
        return bool(np.all(metrics["held_out_stale"] >= self.patience))


class EarlyStopState(flax.struct.PyTreeNode):
    """A grounding and the best that it has been.

    Attributes:
      grounding: where it stands.
      best: parameters of pi_g that predicted the rows held out best.
      error: of `best`.
      stale: iterations since.
    """

    grounding: GroundingState
    best: Params
    error: Float[Array, "*n"]
    stale: Int[Array, "*n"]

    @property
    def result(self) -> Transformer:
        """The best transformer so far, the start among them."""
        return self.grounding.transformer.replace(params=self.best)


def init(grounding: GroundingState, env: Env, rows: HeldOut) -> EarlyStopState:
    """A grounding that is about to begin, judged where it starts."""
    return EarlyStopState(
        grounding=grounding,
        best=jax.tree.map(jnp.copy, grounding.result.params),
        error=prediction.one_step_error(env, grounding.result, rows),
        stale=jnp.zeros((), jnp.int32),
    )


def update(
    state: EarlyStopState, grounding: GroundingState, env: Env, rows: HeldOut
) -> tuple[EarlyStopState, Metrics]:
    """Judges what `grounding` has come to.

    Returns:
      The next state, and metrics, each `[]`: `held_out_error` of this iteration, `held_out_best` so far, and
      `held_out_stale`, the iterations since.
    """
    error = prediction.one_step_error(env, grounding.result, rows)
    better = error < state.error
    state = EarlyStopState(
        grounding=grounding,
        best=select(better, grounding.result.params, state.best),
        error=jnp.where(better, error, state.error),
        stale=jnp.where(better, 0, state.stale + 1),
    )
    return state, {
        "held_out_error": error,
        "held_out_best": state.error,
        "held_out_stale": state.stale,
    }
