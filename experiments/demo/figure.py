"""The figure of both policies' returns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.demo.policy import CONFIG
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, NOMINAL

COLORS = (NOMINAL, CORRECTED)


def returns_figure(returns: dict[str, dict[str, list[float | None]]], path: Path) -> Path:
    """Learning curves on the left; on the right a point for every episode in the target, and their mean.

    Args:
        returns: by where a policy was trained, `curve` and `target`.
    """
    figure = Figure(figsize=(9.6, 2.8), layout="constrained")
    learning, target = figure.subplots(1, 2, width_ratios=(3, 2))
    rng = np.random.default_rng(0)
    for row, ((name, r), color) in enumerate(zip(returns.items(), COLORS, strict=True)):
        curve = np.array(r["curve"], float)
        steps = [CONFIG.env_steps(i + 1) / 1000 for i in range(curve.size)]
        learning.plot(steps, curve, color=color, label=name)
        values = np.array(r["target"], float)
        target.scatter(
            values, row + 0.12 * rng.standard_normal(values.size), s=9, color=color, alpha=0.5, lw=0
        )
        target.plot([values.mean()] * 2, [row - 0.35, row + 0.35], color=color, lw=2.5)
    learning.set_xlabel("steps in its simulator (thousands)")
    learning.set_ylabel("return there")
    learning.legend(fontsize=8, title="simulator", title_fontsize=8)
    target.set_yticks(range(len(returns)), list(returns))
    target.set_ylim(len(returns) - 0.5, -0.5)
    target.set_xlim(0, 100)
    target.set_xlabel("return in the target, 50 episodes")
    for ax in (learning, target):
        ax.grid(alpha=0.25)
    return drawing.save(figure, path)
