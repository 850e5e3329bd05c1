"""Domain randomisation: agents trained in many machines around the simulator, without a step in the target."""

from envs.randomised import RandomisedEnv, Ranges
from experiments.methods.cell import Trained, Work
from experiments.methods.training import train

RANGES = Ranges()
"""Chosen before any target was looked at: what a careful modeller would not be surprised to be wrong by."""


def randomised(work: Work) -> Trained:
    """Agents trained in a machine that is drawn anew for every episode."""
    env = RandomisedEnv(work.source, RANGES)
    count = len(work.cell.seeds)
    return Trained(train(work, lambda _: env), [0] * count, [{}] * count)
