"""Runs a cell: policies, a log of the target, the method, and an evaluation in the target or on what was held out."""

from pathlib import Path
from typing import Any

import numpy as np

import envs
from envs.c_engine import cores
from experiments.methods import logged, recording, training
from experiments.methods.cell import Cell, Outcome, Trained, Work
from experiments.methods.registry import METHODS
from mpge_jax.grounding import prediction, transform_error
from mpge_jax.rollouts import policies
from mpge_jax.rollouts.policies import PolicySet

POLICY = "policy"
"""Folder of the agents that were trained for a target that only a log tells of."""


def run(cell: Cell, folder: Path, quiet: bool = False, threads: int | None = None) -> Outcome:
    """Runs a cell; what it needs to be resumed is kept in `folder`. `threads`: of a diagnosis; all cores by default."""
    threads = cores() if threads is None else threads
    method = METHODS[cell.method]
    source = envs.make(envs.source_of(cell.task), cell.backend, cell.dynamics)
    sets = recording.sets_of(cell, method, source.name)
    if cell.files is not None:
        return _from_log(cell, source, sets, folder, quiet, threads)
    target = envs.make(cell.task, cell.backend, cell.dynamics)
    logs = recording.record(cell, method, target, sets, folder) if method.samples == "log" else None
    truth = transform_error.truth_of(target)
    made = method.work(Work(cell, method, source, target, sets, logs, folder, truth, quiet, threads=threads))
    agents = policies.from_learners(made.learners)
    returns = training.evaluate(cell, target, agents)
    measured = [
        {
            **{name: float(np.mean(values[i])) for name, values in returns.items()},
            **{f"{name}_std": float(np.std(values[i])) for name, values in returns.items()},
        }
        for i in range(len(cell.seeds))
    ]
    return Outcome(_rows(cell, made, measured), made.seconds, made.curve, made.transformers, agents)


def _from_log(
    cell: Cell, source: envs.Env, sets: PolicySet, folder: Path, quiet: bool, threads: int
) -> Outcome:
    """A cell whose target is known by a recorded log alone: no return, but what the simulator predicts of the log."""
    assert cell.files is not None
    method = METHODS[cell.method]
    logs, acted = logged.part_of(cell, method, source.name)
    judges = logged.held_out(logged.read(cell.files, source.name).held)
    work = Work(cell, method, source, None, sets, logs, folder, None, quiet, acted, judges, threads)
    given = logged.prediction_error(work, lambda rows: prediction.error_under(source, rows, rows.action))
    made = method.work(work)
    agents = policies.from_learners(made.learners)
    policies.save_checkpoint(folder / POLICY, agents)
    measured = [
        {
            "simulator_error": given.get("held_out_error"),
            "held_out_transitions": int(np.sum(judges.weight)),
        }
    ] * len(cell.seeds)
    return Outcome(_rows(cell, made, measured), made.seconds, made.curve, made.transformers, agents)


def _rows(cell: Cell, made: Trained, measured: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            "task": cell.task,
            "method": cell.method,
            "samples": cell.samples,
            "seed": seed,
            "target_steps": made.target_steps[i],
            **measured[i],
            **made.extra[i],
        }
        for i, seed in enumerate(cell.seeds)
    ]
