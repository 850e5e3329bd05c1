"""docs/gpu.md from what `make gpu-check`, or parts of it, left: `python -m experiments.benchmark.gpu FILE ...`."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.benchmark.clock import Row
from experiments.benchmark.table import tables
from experiments.ending import exit_status
from mpge_jax import files

HEAD = """# On an NVIDIA GPU

`make gpu-check` measures it in one command and writes `results/gpu`; this page is
`python -m experiments.benchmark.gpu FILE ...` of what such runs left in [results/gpu](results/gpu). Rates include
observation, reward and resets, for grounding also the updates of discriminator, policy and value functions; compilation
is left out and told apart. `c` is MuJoCo's C engine on the processor of the same machine, `mjx` is MJX in JAX, `warp`
is MJX in Warp. On a GPU, grounding takes the paper's batch of 2,048 as one step of 2,048 simulators a transformer.
A size that a command names and no row shows was not reached in the time that the machine was lent.
"""


@dataclass(frozen=True)
class Args:
    """Writes the page of what was measured on an NVIDIA GPU."""

    records: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(help="benchmark.json of each run")
    ]
    out: Annotated[Path, tyro.conf.arg(help="the page")] = Path("docs/gpu.md")


def page(records: list[Row]) -> str:
    """The page of runs on one machine.

    Raises:
      ValueError: no runs, or runs on several machines.
    """
    machines = {record["versions"]["machine"] for record in records}
    if len(machines) != 1:
        raise ValueError(
            f"give the runs of one machine, got those of {len(machines)}: {', '.join(sorted(machines))}"
        )
    rows = [row for record in records for row in record["rows"] if row.get("backend") != "gymnasium"]
    lines = [HEAD.rstrip("\n"), "", f"Machine: {machines.pop()}. Runs:", ""]
    for record in records:
        used = ", ".join(
            f"{name} {record['versions'][name]}" for name in ("python", "jax", "mujoco", "mujoco-mjx")
        )
        lines.append(f"- `{record['command']}`: commit {record['versions']['commit']}, {used}")
    return "\n".join([*lines, *tables(rows), "", *_compared(rows)]) + "\n"


def _compared(rows: list[Row]) -> list[str]:
    """What the tables say of Warp beside MJX in JAX, where both were measured."""
    rates = {
        (row["part"], row.get("backend"), row.get("members"), row.get("copies")): row["rate"] for row in rows
    }
    said = []
    for part, what in (("envs", "of environment steps"), ("grounding", "of grounding")):
        found = [
            (key, rate / rates[part, "mjx", *key[2:]])
            for key, rate in rates.items()
            if key[:2] == (part, "warp") and (part, "mjx", *key[2:]) in rates
        ]
        if found:
            times = [ratio for _, ratio in found]
            said.append(f"{min(times):.1f} to {max(times):.1f} times the rate {what}")
    return [f"Warp makes {' and '.join(said)} that MJX in JAX makes at the same sizes."] if said else []


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("gpu", _write, goes_on=False)


def _write() -> int:
    args = tyro.cli(Args, prog="python -m experiments.benchmark.gpu", description=Args.__doc__)
    files.write_text(args.out, page([json.loads(file.read_text("utf-8")) for file in args.records]))
    print(f"written: {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
