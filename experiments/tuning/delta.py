"""How a delta action model learns to follow a log: how far it may reach, and how much later steps count.

python -m experiments.tuning.delta --out docs/results/delta

Follows logs of a target that no table of results shows, and writes docs/delta.md. What is done is not run again.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

import envs
from experiments.ending import exit_status
from experiments.methods import residual
from experiments.presets import STANDARD
from experiments.storage import versions
from experiments.tuning.search import register
from mpge_jax import files, loop
from mpge_jax.grounding import delta_action, transform_error
from mpge_jax.grounding.delta_action import TrackingEnv
from mpge_jax.learning import agent
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.trajectories import trajectories

TASK, SAMPLES, ITERATIONS = "TuningCheetah", 5_000, 60
SETTINGS = ((0.5, 0.99), (1.0, 0.99), (1.0, 0.7), (1.0, 0.3), (1.0, 0.0))
"""Reach, in widths of the box of actions, and discount."""


@dataclass
class Args:
    """Measure what reach and discount do."""

    out: Annotated[Path, tyro.conf.arg(help="folder for a JSON file of each setting")]
    page: Annotated[Path, tyro.conf.arg(help="where the table goes")] = Path("docs/delta.md")


def trial(reach: float, discount: float) -> dict[str, Any]:
    """What one model comes to: its mean return of following, of 16 at most, and its action-transformation error along
    random rollouts, of which `nothing` is the one of no change."""
    target, source = envs.make(TASK), envs.make(envs.source_of(TASK))
    rollout = policies.shipped(source.name, "MS")[0].rollout
    log = target_log.collect(jax.random.key(0), target, rollout, SAMPLES)
    env = TrackingEnv(source, trajectories(log), replace(residual.CONFIG, reach=reach))
    config = residual.learner_of(STANDARD.tasks[source.name].agent, discount)
    truth = transform_error.truth_of(target)
    assert truth is not None
    step = jax.jit(lambda state: agent.iterate(state, env, config))
    state, curve = loop.run(
        step,
        jax.jit(lambda key: agent.init(key, env, config))(jax.random.key(1)),
        ITERATIONS,
        title=f"reach {reach:g}, discount {discount:g}",
    )

    def error(executed: transform_error.Executed) -> float:
        measure = jax.jit(
            lambda key, actor: transform_error.in_rollouts(key, actor, source, truth, executed=executed)
        )
        return float(measure(jax.random.key(2), state.learner.actor))

    return {
        "reach": reach,
        "discount": discount,
        "following": float(curve["return"][-5:].mean()),
        "error": error(delta_action.executed),
        "nothing": error(lambda _actor, _observation, action, _low, _high: action),
        "versions": versions(),
    }


def page(rows: list[dict[str, Any]]) -> str:
    """The table."""
    own = residual.CONFIG.reach, residual.DISCOUNT
    lines = [
        "# How a delta action model learns to follow a log",
        "",
        "Written by `python -m experiments.tuning.delta --out docs/results/delta`. `delta` ([methods](methods.md)) "
        f"follows {SAMPLES:,} transitions of `{TASK}`, which no table of results shows, for {ITERATIONS} iterations of "
        "the preset `standard`; one seed. Error: mean distance to the true change of actions along random rollouts; no "
        f"change at all scores {rows[0]['nothing']:.2f}. **Bold**: what the sweep has.",
        "",
        "| reach (widths of the box) | discount | return of following (16 at most) | error |",
        "|--:|--:|--:|--:|",
    ]
    for row in rows:
        cells = [
            f"{row['reach']:g}",
            f"{row['discount']:g}",
            f"{row['following']:.2f}",
            f"{row['error']:.2f}",
        ]
        chosen = (row["reach"], row["discount"]) == own
        lines.append(f"| {' | '.join(f'**{x}**' if chosen else x for x in cells)} |")
    nearer = sum(row["error"] < row["nothing"] for row in rows)
    lines += [
        "",
        "What an action does shows in the very next state. With the usual discount that drowns in what all later steps "
        "are worth. Half a width does not turn an action into its opposite.",
        "",
        f"Under random actions, away from what was logged, {nearer or 'none'} of the {len(rows)} models "
        f"{'is' if nearer < 2 else 'are'} nearer to the truth than no change is: an agent that leaves the log is told "
        "wrong there.",
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("tuning.delta", _run)


def _run() -> int:
    args = tyro.cli(Args, prog="python -m experiments.tuning.delta", description=Args.__doc__)
    register()
    rows = []
    for reach, discount in SETTINGS:
        path = args.out / f"reach-{reach:g}-discount-{discount:g}.json"
        if not path.is_file():
            files.write_text(path, json.dumps(trial(reach, discount), indent=1) + "\n")
        rows.append(json.loads(path.read_text("utf-8")))
    files.write_text(args.page, page(rows))
    print(f"written: {args.page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
