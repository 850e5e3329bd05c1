"""docs/speed.md: what was measured beside other libraries, and whether it meets what was aimed at."""

import json
import statistics
from dataclasses import dataclass
from pathlib import Path

from experiments.benchmark.clock import Row
from experiments.benchmark.grounding import REFERENCE
from experiments.benchmark.peers import environment_steps, error_time, gail, growth
from experiments.benchmark.peers.in_turn import OURS, rates, ratio
from experiments.benchmark.peers.rows import ROWS, SYSID, install

TITLES = {
    "steps": "Environment steps of HalfCheetahs whose actions a 256-256 policy draws",
    "sac": "SAC updates: 256-256, batch 256, HalfCheetah's sizes",
    "grounding": "Grounding, learning included: simulator steps, HalfCheetah, the paper's networks and batch",
    "error": "Grounding: time to an error of 0.10",
    "growth": "Growth of an iteration of grounding",
    "fit": "Diagnosis: given parameters of a chain on given windows",
}
HEAD = """# Speed beside others

Written by `python -m experiments.benchmark.peers` from [results/speed](results/speed). Ours and the peers' work were
measured in turn in one process; a ratio is the median over rounds of ours to the peer's within the round (its quartiles
in brackets), so that what else the machine does hits both. Compilation is left out. Where the load average of a row
is above 2, other work ran beside it: rates are too low, and ratios are what to read. On an NVIDIA GPU:
[gpu.md](gpu.md).
"""
NOTES = {
    "steps": "{copies} copies. "
    "Ours: policy, observation, reward and automatic resets included. Raw `mujoco.batch` steps the same "
    "copies under commands drawn before, and does nothing else. Gymnasium's vector environment (8 copies, one "
    "process) has no policy either. MJX runs our task with the same policy.",
    "sac": "{updates} updates a call. "
    "Each draws its batch from a full buffer of 10,000 transitions. Ours and SBX both make the updates "
    "of a call in one compiled program. In a profile (`jax.profiler`) about nine tenths of our update are matrix "
    "products with what XLA fuses to them, and SBX has the same products to compute.",
    "grounding": "Ours: five rollout policies, 64 simulators, iterations of 2,048 steps; the discriminator's four "
    "updates on 512 rows of each side, TRPO and the value functions. `imitation` 1.0.1: 2,048 steps of 8 environments, "
    "the same networks, batches and updates, TRPO by sb3-contrib, with one value function and no gradient penalty, on "
    "a log that is drawn; it runs in a Python of its own (it wants gymnasium below 1) and tells its own seconds.",
    "fit": "{parameters} parameters, {joints} joints, {windows} windows. "
    "Ours and sysid's own optimiser (Gauss-Newton, finite differences, MuJoCo's rollouts) minimise the same "
    "whitened residuals from the nominal model; sysid's clock stops where it first is within 0.1 % of our loss. It "
    "begins a twentieth of its range off its bounds, as it advises. The whole search knows neither which effects act "
    "nor where.",
}

GROWTH = "images/growth.png"
"""The figure, beside the page."""

LACKING = "## Not measured\n\n"


@dataclass(frozen=True)
class Mark:
    """What was aimed at: at least `least` times the rate of a peer."""

    row: str
    peer: str
    least: float


MARKS = (
    Mark("steps", environment_steps.RAW, 0.7),
    Mark("steps", environment_steps.MJX, 15.0),
    Mark("sac", "SBX", 1.3),
    Mark("grounding", gail.PEER, 10.0),
    Mark("fit", SYSID, 5.0),
)
TIMES = 25.0
"""Times the rate of the paper's released code."""
SEARCH = 3.0
"""Times sysid's fit that the whole search was to take at most."""


def markdown(kept: Path) -> str:
    """The page from the files in `kept`.

    Raises:
      FileNotFoundError: nothing was measured yet.
    """
    files = {name: kept / f"{name}.json" for name in ROWS}
    rows = {name: json.loads(file.read_text("utf-8")) for name, file in files.items() if file.is_file()}
    if not rows:
        raise FileNotFoundError(f"nothing was measured yet in {kept}")
    lacking = [f"- {TITLES[name]}: `--row {name}` measures it.\n" for name in ROWS if name not in rows]
    parts = [HEAD, *(_section(name, row) for name, row in rows.items())]
    if lacking:
        parts.append(LACKING + "".join(lacking))
    return "\n".join(parts)


def draw(kept: Path, docs: Path) -> None:
    """The figure of what was measured, where it was, beside the page."""
    if (file := kept / "growth.json").is_file():
        growth.draw(json.loads(file.read_text("utf-8")), docs / GROWTH)


def _section(name: str, row: Row) -> str:
    lines = [f"## {TITLES[name]}", ""]
    match name:
        case "error":
            lines += error_time.lines(row)
        case "growth":
            lines += growth.lines(row, GROWTH)
        case _:
            lines += _beside(name, row)
    used = {
        who: v for who, v in {**row["versions"], **row["peers"]}.items() if who not in ("machine", "commit")
    }
    load = " and ".join(f"{x:.1f}" for x in row["load_average"])
    made = f"`{row['command']}` on {row['versions']['machine']}; load average before and after: {load}."
    return "\n".join([*lines, "", f"{made} {', '.join(f'{who} {v}' for who, v in used.items())}.", ""])


def _beside(name: str, row: Row) -> list[str]:
    lines = [NOTES[name].format(**row), ""]
    lines += ["| | a second | ours to it | aimed at | |", "|---|--:|--:|--:|---|"]
    seconds = row["seconds"]
    beside = {who: taken for who, taken in seconds.items() if len(taken) == len(seconds.get(OURS, ()))}
    for who, rate in rates(beside, row["amounts"]).items():
        low, middle, high = ratio(beside, row["amounts"], who)
        least = next((mark.least for mark in MARKS if (mark.row, mark.peer) == (name, who)), None)
        cells = [who, f"{rate:,.0f}" if rate >= 100 else f"{rate:.3g}"]
        cells += ["" if who == OURS else f"{middle:.2f} ({low:.2f} to {high:.2f})"]
        cells += ["", ""] if least is None else [f"{least:g}", _said(middle >= least)]
        lines.append(f"| {' | '.join(cells)} |")
    lines += [f"| {who} | not run: `{install(who)}` | | | |" for who in row["missing"]]
    if name == "grounding" and seconds:
        lines += ["", _reference(rates(beside, row["amounts"])[OURS])]
    if "whole search" in seconds:
        lines += ["", _search(row)]
    return lines


def _said(met: bool) -> str:
    return "met" if met else "**missed**"


def _reference(rate: float) -> str:
    return (
        f"The paper's released code made {REFERENCE:g} steps a second on two cores, in another run, under a load that "
        f"is not known: ours makes {rate / REFERENCE:.0f} times as many (aimed at: {TIMES:g}): "
        f"{_said(rate >= TIMES * REFERENCE)}."
    )


def _search(row: Row) -> str:
    (search,) = row["seconds"]["whole search"]
    times = search / statistics.median(row["seconds"]["sysid to its end"])
    losses = ", ".join(f"{who} {loss:.4f}" for who, loss in row["loss"].items())
    return (
        f"The whole search took {search:.0f} s, {times:.0f} times sysid's fit of given parameters to its end "
        f"(aimed at: at most {SEARCH:g}): {_said(times <= SEARCH)}. Losses where each ended: {losses}."
    )
