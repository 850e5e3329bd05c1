"""Runs a cell: policies, a log of the target, the method, and an evaluation in the target."""

from pathlib import Path

import numpy as np

import envs
from experiments.methods import recording, training
from experiments.methods.cell import Cell, Outcome, Work
from experiments.methods.registry import METHODS
from mpge_jax.grounding import transform_error
from mpge_jax.rollouts import policies


def run(cell: Cell, folder: Path, quiet: bool = False) -> Outcome:
    """Runs a cell; what it needs to be resumed is kept in `folder`."""
    method = METHODS[cell.method]
    target = envs.make(cell.task, cell.backend, cell.dynamics)
    source = envs.make(envs.source_of(cell.task), cell.backend, cell.dynamics)
    sets = recording.sets_of(cell, method, source.name)
    logs = recording.record(cell, method, target, sets, folder) if method.samples == "log" else None
    truth = transform_error.truth_of(target)
    made = method.work(Work(cell, method, source, target, sets, logs, folder, truth, quiet))
    agents = policies.from_learners(made.learners)
    returns = training.evaluate(cell, target, agents)
    rows = [
        {
            "task": cell.task,
            "method": cell.method,
            "samples": cell.samples,
            "seed": seed,
            "target_steps": made.target_steps[i],
            **{name: float(np.mean(values[i])) for name, values in returns.items()},
            **{f"{name}_std": float(np.std(values[i])) for name, values in returns.items()},
            **made.extra[i],
        }
        for i, seed in enumerate(cell.seeds)
    ]
    return Outcome(rows, made.seconds, made.curve, made.transformers, agents)
