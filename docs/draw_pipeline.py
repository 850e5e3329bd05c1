"""Draws docs/images/pipeline.png, the picture of the README: `python docs/draw_pipeline.py`."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

INK, SIM, REAL, LEARNED = "#1b1f24", "#dcebf7", "#fbe3cf", "#dff1e6"
Box = tuple[float, float, float, float]


def box(axes: Axes, x: float, y: float, title: str, text: str, colour: str, width: float = 2.5) -> Box:
    """A titled box with its lower left corner at (x, y)."""
    height = 1.3
    axes.add_patch(
        FancyBboxPatch(
            (x, y),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=0.12",
            facecolor=colour,
            edgecolor=INK,
            lw=1.1,
        )
    )
    middle = x + width / 2
    axes.text(
        middle,
        y + height - 0.29,
        title,
        ha="center",
        va="center",
        fontsize=11.5,
        fontweight="bold",
        color=INK,
    )
    axes.text(middle, y + 0.47, text, ha="center", va="center", fontsize=10, color=INK, linespacing=1.35)
    return x, y, width, height


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], bend: float = 0.0) -> None:
    axes.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle="-|>",
            mutation_scale=15,
            color=INK,
            lw=1.3,
            connectionstyle=f"arc3,rad={bend}",
            shrinkA=2,
            shrinkB=2,
        )
    )


def right(b: Box) -> tuple[float, float]:
    return b[0] + b[2], b[1] + b[3] / 2


def left(b: Box) -> tuple[float, float]:
    return b[0], b[1] + b[3] / 2


def bottom(b: Box) -> tuple[float, float]:
    return b[0] + b[2] / 2, b[1]


def top(b: Box) -> tuple[float, float]:
    return b[0] + b[2] / 2, b[1] + b[3]


def draw(path: Path) -> None:
    """The two halves of the project, above and below what they share: data of the target."""
    figure, axes = plt.subplots(figsize=(12, 5.0))
    axes.set(xlim=(-0.05, 14.05), ylim=(-0.2, 5.6))
    axes.axis("off")

    policies = box(axes, 0, 3.6, "source policies", "K policies trained\nin the simulator", SIM)
    ground = box(
        axes,
        5.4,
        3.6,
        "ground",
        "$\\pi_g$ alters actions until\nthe simulator moves alike",
        LEARNED,
        3.1,
    )
    agent = box(axes, 9.1, 3.6, "train", "an agent, in an\nensemble of N", LEARNED, 2.2)
    result = box(axes, 11.9, 3.6, "policy", "that works\nin the target", REAL, 2.1)

    target = box(axes, 0, 1.75, "target", "the machine whose\ndynamics differ", REAL)
    log = box(axes, 3.0, 1.75, "target log", "n transitions,\nall counted", REAL, 1.95)

    diagnose = box(
        axes, 5.4, -0.1, "diagnose", "fit each known effect,\njudge on held-out data", LEARNED, 3.1
    )
    cause = box(axes, 9.1, -0.1, "cause", "which effect,\nwhere, how sure", LEARNED, 2.2)
    model = box(axes, 11.9, -0.1, "model", "corrected\nMJCF", SIM, 2.1)

    arrow(axes, bottom(policies), top(target))
    arrow(axes, right(target), left(log))
    arrow(axes, (log[0] + log[2], log[1] + 0.95), (ground[0] + 0.35, ground[1]), -0.12)
    arrow(axes, (log[0] + log[2], log[1] + 0.35), (diagnose[0] + 0.35, diagnose[1] + diagnose[3]), 0.12)
    arrow(axes, right(policies), left(ground))
    for a, b in ((ground, agent), (agent, result), (diagnose, cause), (cause, model)):
        arrow(axes, right(a), left(b))
    note = {"fontsize": 10.5, "color": INK, "style": "italic", "va": "center"}
    axes.text(5.4, 5.2, "make a policy carry over   (experiments.sweep)", **note)
    axes.text(6.1, 1.5, "say what the simulator has wrong   (experiments.diagnose)", **note)
    for x, colour, text in ((0.0, SIM, "simulator"), (1.55, REAL, "target"), (2.75, LEARNED, "learned")):
        axes.add_patch(plt.Rectangle((x, -0.05), 0.22, 0.22, facecolor=colour, edgecolor=INK, lw=0.8))
        axes.text(x + 0.32, 0.06, text, fontsize=9.4, va="center", color=INK)

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130, bbox_inches="tight", facecolor="white")
    plt.close(figure)


if __name__ == "__main__":
    draw(Path(__file__).parent / "images" / "pipeline.png")
