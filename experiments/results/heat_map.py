"""How far grounded simulators are from the target along each rollout policy (the paper's heat map).

python -m experiments.results.heat_map results/BrokenCheetah-standard

Reads the transformers that the cells of a sweep left, and writes heat_map.json and heat_map.png into its folder.
"""

import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import tyro

from mpge_jax import own_envs as own_envs  # isort: split

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import envs
from experiments.ending import exit_status
from experiments.methods import METHODS
from experiments.report import save_figure
from experiments.results.sweeps import grounded_cells, keep_measured, read_json
from experiments.storage import SweepFolder, versions
from mpge_jax.grounding import transform_error
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning import sac
from mpge_jax.rollouts import policies
from mpge_jax.rollouts.policies import PolicySet

NAME = "heat_map"


@dataclass(frozen=True)
class Args:
    """Draws the action-transformation error of a sweep's transformers along every rollout policy."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(help="folder of a sweep")]
    steps: Annotated[int, tyro.conf.arg(help="simulator steps along each policy, for each transformer")] = (
        2048
    )

    def __post_init__(self) -> None:
        if self.steps < 8 or self.steps % 8:
            raise ValueError(
                f"--steps: eight episodes share them, so a multiple of 8 is needed, not {self.steps}."
            )


def errors(
    key: jax.Array,
    transformers: Transformer,
    driving: PolicySet,
    env: envs.Env,
    truth: transform_error.Truth,
    steps: int,
) -> np.ndarray:
    """Errors [T, K] of T transformers (every leaf `[T, ...]`) along K policies, stochastic as when they recorded."""

    def one(key: jax.Array, pi_g: Transformer, actor: sac.Actor) -> jax.Array:
        return transform_error.in_rollouts(
            key, pi_g, env, truth, steps, lambda obs, key: sac.act(actor, obs, key)
        )

    rows = jax.vmap(jax.vmap(one, (None, None, 0)), (0, 0, None))
    count = transformers.input_mean.shape[0]
    return np.asarray(jax.jit(rows)(jax.random.split(key, count), transformers, driving.actor))


def measured(folder: Path, steps: int) -> dict[str, Any]:
    """The errors of every cell of a sweep that has transformers, and what they are of.

    Raises:
      ValueError: the target is no change of actions, so that there is no true transformation.
    """
    identity = read_json(folder / "sweep.json")["identity"]
    source_name = envs.source_of(identity["task"])
    source = envs.make(source_name, identity["backend"], identity["dynamics"])
    truth = transform_error.truth_of(envs.make(identity["task"], identity["backend"], identity["dynamics"]))
    if truth is None:
        raise ValueError(
            f"{identity['task']} differs from {source_name} otherwise than by its actions: there is no true change of "
            "actions to compare with."
        )
    coefficient = identity["preset"]["entropy_coefficient"]
    sweep = SweepFolder(folder, identity)
    cells = {}
    for method, samples, made in grounded_cells(sweep):
        driving, _ = policies.shipped(source_name, METHODS[method].kind, coefficient)
        flat = jax.tree.map(lambda x: jnp.reshape(x, (-1, *x.shape[2:])), made)
        key = jax.random.key(zlib.crc32(f"heat map/{method}/{samples}".encode()))
        found = errors(key, flat, driving, source, truth, steps)
        seeds = made.input_mean.shape[0]
        cells[f"{method}-{samples}"] = found.reshape(seeds, -1, driving.size).round(5).tolist()
    return {
        "task": identity["task"],
        "steps": steps,
        "versions": versions(),
        "cells": cells,
    }


def draw(record: dict[str, Any], path: Path) -> None:
    """One panel for each cell: transformers down, seed by seed, rollout policies across."""
    cells = {name: np.array(value) for name, value in record["cells"].items()}
    heights = [c.shape[0] * c.shape[1] for c in cells.values()]
    figure, panels = plt.subplots(
        1,
        len(cells),
        figsize=(1.2 + 2.3 * len(cells), 1.6 + 0.22 * max(heights)),
        squeeze=False,
        layout="constrained",
    )
    most = max(float(c.max()) for c in cells.values())
    for axes, (name, c) in zip(panels[0], cells.items(), strict=True):
        seeds, members, size = c.shape
        flat = c.reshape(-1, size)
        image = axes.imshow(flat, vmin=0.0, vmax=most, cmap="viridis", aspect="auto")
        for (row, column), value in np.ndenumerate(flat):
            dark = value < 0.6 * most
            axes.text(
                column, row, f"{value:.2f}", ha="center", va="center", fontsize=6, color="w" if dark else "k"
            )
        axes.set_yticks(
            [members * (s + 0.5) - 0.5 for s in range(seeds)], [f"seed {s}" for s in range(seeds)]
        )
        for s in range(1, seeds):
            axes.axhline(members * s - 0.5, color="w", lw=1.5)
        axes.set_xticks(range(size))
        axes.set(title=name, xlabel="rollout policy")
    figure.colorbar(image, ax=panels[0].tolist(), label="action-transformation error")
    save_figure(figure, path)


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        args = tyro.cli(Args, prog="python -m experiments.results.heat_map", description=Args.__doc__)
        record = measured(args.folder, args.steps)
        keep_measured(args.folder, NAME, record)
        draw(record, args.folder / f"{NAME}.png")
        print(f"written: {args.folder / NAME}.json and .png")
        return 0

    return exit_status("heat_map", work, goes_on=False)


if __name__ == "__main__":
    sys.exit(main())
