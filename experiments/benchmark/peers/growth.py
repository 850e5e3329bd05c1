"""How the time of an iteration of grounding grows with what it is given, and the memory of a large one."""

import json
import os
import statistics
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.benchmark.clock import Row
from experiments.benchmark.grounding import SAMPLES, SOURCE, TARGET, iteration
from experiments.benchmark.peers.in_turn import in_turn, over
from mpge_jax.diagnosis.report.figures.drawing import save
from mpge_jax.grounding.config import GroundingConfig

AXES: dict[str, tuple[int, ...]] = {
    "copies B": (64, 256, 1024),
    "transformers N": (1, 2, 5),
    "policies K": (1, 5, 10),
    "samples": (500, 5_000, 50_000),
    "degrees of freedom": (2, 6, 9),
}
TASKS = {2: ("InvertedPendulum", "SkewedPendulum"), 6: ("Hopper", "BrokenHopper"), 9: (SOURCE, TARGET)}
LARGE = (4_096, 5)
"""Copies and transformers whose memory is measured."""
GIB = 6.0
"""What that was to take at most."""


def measure(rounds: int, axes: dict[str, tuple[int, ...]] = AXES, large: tuple[int, int] = LARGE) -> Row:
    """Seconds of an iteration at every point of every axis, in turn along an axis; the peak memory of `large`."""
    seconds = {}
    # What all axes have in common is compiled once.
    made = cache(iteration)
    for axis, points in axes.items():
        taken = in_turn({str(n): over(made(*_given(axis, n))) for n in points}, rounds, warm=1)
        seconds[axis] = {n: [float(f"{x:.4g}") for x in each] for n, each in taken.items()}
    copies, members = large
    said = subprocess.run(
        [sys.executable, "-m", __name__, str(copies), str(members)],
        capture_output=True,
        text=True,
        env=dict(os.environ),
        check=True,
    ).stdout
    return {"growth": seconds, "large": json.loads(said.splitlines()[-1]), "missing": [], "peers": {}}


def _given(axis: str, n: int) -> tuple[str, int, GroundingConfig, int, int, tuple[str, str]]:
    """Arguments of `iteration`."""
    return (
        "c",
        n if axis == "transformers N" else 1,
        replace(GroundingConfig(), num_envs=n) if axis == "copies B" else GroundingConfig(),
        n if axis == "samples" else SAMPLES,
        n if axis == "policies K" else 5,
        TASKS[n] if axis == "degrees of freedom" else (SOURCE, TARGET),
    )


def slope(times: dict[str, list[float]]) -> float:
    """Exponent of the growth: the slope of the line through the medians on logarithmic axes."""
    n, median = np.array([int(n) for n in times]), np.array([statistics.median(x) for x in times.values()])
    return float(np.polyfit(np.log(n), np.log(median), 1)[0])


def lines(row: Row, image: str) -> list[str]:
    """The section of the page."""
    out = [
        "Seconds of an iteration, 32 steps of each copy, on the C engine, learning included, along one axis at a time; "
        f"else 64 copies, one transformer, five policies, {SAMPLES:,} samples, {SOURCE}. The slope is the exponent: 1 "
        "doubles the time with twice as many, 0 changes nothing.",
        "",
        f"![Seconds of an iteration against copies, transformers, policies, samples and degrees of freedom]({image})",
        "",
        "| | from | to | seconds from | to | slope |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for axis, times in row["growth"].items():
        first, last = (list(times)[at] for at in (0, -1))
        ends = (f"{statistics.median(times[n]):.3g}" for n in (first, last))
        out.append(f"| {axis} | {int(first):,} | {int(last):,} | {' | '.join(ends)} | {slope(times):.2f} |")
    large = row["large"]
    met = "met" if large["gib"] <= GIB else "**missed**"
    out += [
        "",
        f"{large['copies']:,} copies and {large['members']} transformers, compiled and two iterations made in a "
        f"process of its own: {large['gib']:.2f} GiB at its peak (aimed at: at most {GIB:g}): {met}. The second took "
        f"{large['seconds']:.0f} s.",
    ]
    return out


def draw(row: Row, path: Path) -> Path:
    """The figure of slopes: times over the first of each axis."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    ax = figure.subplots()
    for axis, times in row["growth"].items():
        n = np.array([int(n) for n in times])
        median = np.array([statistics.median(x) for x in times.values()])
        ax.plot(
            n / n[0], median / median[0], marker="o", ms=4, label=f"{axis} from {n[0]}: {slope(times):.2f}"
        )
    far = max(int(max(t, key=int)) / int(min(t, key=int)) for t in row["growth"].values())
    ax.plot([1, far], [1, far], color="#999999", ls=":", label="in proportion: 1")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("times as many")
    ax.set_ylabel("times the seconds of an iteration")
    ax.legend(fontsize=8, title="slope", title_fontsize=8)
    ax.grid(alpha=0.25)
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(figure, path)


def _memory(copies: int, members: int) -> dict[str, float]:
    """Peak memory of this process after two iterations, and the seconds of the second."""
    import resource
    import time

    call = over(iteration("c", members, replace(GroundingConfig(), num_envs=copies)))
    call()
    start = time.perf_counter()
    call()
    seconds = time.perf_counter() - start
    kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    return {"copies": copies, "members": members, "gib": round(kib / 2**20, 3), "seconds": round(seconds, 2)}


if __name__ == "__main__":
    print(json.dumps(_memory(*map(int, sys.argv[1:]))))
