"""Measures this machine: simulation, grounding and SAC, as rates and as ratios. `--help` lists what is allowed.

Every rate is amount / median duration of repeated calls, compilation excluded and reported apart.
"""

import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import jax
import tyro
from rich.console import Console
from rich.markdown import Markdown

from experiments.benchmark import grounding, sac, simulation, table
from experiments.benchmark.clock import Row
from experiments.benchmark.simulation import available
from experiments.benchmark.table import PARTS
from experiments.ending import exit_status
from experiments.storage import versions
from mpge_jax import files
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.learning.sac import SACConfig


@dataclass(frozen=True)
class Args:
    """Measures simulation, grounding and SAC on this machine."""

    part: Annotated[tuple[str, ...], tyro.conf.arg(help="what to measure: " + ", ".join(PARTS))] = PARTS
    backend: Annotated[
        tuple[str, ...],
        tyro.conf.arg(help="physics: c, mjx, warp", help_behavior_hint="(default: all that run here)"),
    ] = ()
    copies: Annotated[
        tuple[int, ...],
        tyro.conf.arg(
            help="parallel environments of part envs", help_behavior_hint="(default: by backend and device)"
        ),
    ] = ()
    members: Annotated[
        tuple[int, ...], tyro.conf.arg(help="transformers grounded, and SAC agents trained, at once")
    ] = (1, 5)
    seconds: Annotated[float, tyro.conf.arg(help="how long each measurement repeats its call")] = 3.0
    out: Annotated[Path, tyro.conf.arg(help="folder of benchmark.json and benchmark.md")] = Path(
        "results/benchmark"
    )


def check(args: Args) -> None:
    """Raises ValueError, one sentence, for what cannot be measured."""
    for part in args.part:
        if part not in PARTS:
            raise ValueError(f"--part {part} is not known (allowed: {', '.join(PARTS)})")
    for backend in args.backend:
        if backend not in ("c", "mjx", "warp"):
            raise ValueError(f"--backend {backend} is not known (allowed: c, mjx, warp)")
        if backend not in available():
            raise ValueError(
                f"--backend {backend} needs an NVIDIA GPU and `make cuda`; JAX runs on {_device()}"
            )
    for option in ("copies", "members"):
        if any(number < 1 for number in getattr(args, option)):
            raise ValueError(f"--{option} must be at least 1, got {min(getattr(args, option))}")
    if not args.members:
        raise ValueError("--members needs at least one number")
    if not args.seconds > 0:
        raise ValueError(f"--seconds must be positive, got {args.seconds}")
    if args.out.exists() and not args.out.is_dir():
        raise ValueError(f"--out {args.out} is a file; give a folder")


def _device() -> str:
    return jax.devices()[0].device_kind


def _copies(args: Args, backend: str) -> tuple[int, ...]:
    if args.copies:
        return args.copies
    if backend == "c":
        return (1, 64, 1_024)
    return (16,) if jax.default_backend() == "cpu" else (4_096,)


def plan(args: Args) -> Iterator[tuple[str, str, Callable[[], Row]]]:
    """What will be measured: part, label and the measurement."""
    backends = args.backend or available()
    on_cpu = jax.default_backend() == "cpu"
    if "envs" in args.part:
        yield "envs", "gymnasium, 1 copy", partial(simulation.measure_gymnasium, args.seconds)
        for backend in backends:
            for copies in _copies(args, backend):
                label = f"{backend}, {copies} copies"
                yield "envs", label, partial(simulation.measure_env, backend, copies, args.seconds)
    if "grounding" in args.part:
        # The paper's batch of 2,048 and networks either way; an accelerator prefers it as copies.
        config = GroundingConfig() if on_cpu else GroundingConfig(num_envs=2_048, steps_per_iteration=1)
        # MJX on a CPU is for tests: it is grounded there only where asked for.
        chosen = args.backend or (("c",) if on_cpu else tuple(b for b in backends if b != "c"))
        for backend in chosen:
            for members in args.members:
                label = f"{backend}, {members} at once"
                yield (
                    "grounding",
                    label,
                    partial(grounding.measure_grounding, backend, members, config, args.seconds),
                )
    if "stages" in args.part:
        for stage in grounding.STAGES:
            for members in args.members:
                yield (
                    "stages",
                    f"{stage}, {members} at once",
                    partial(grounding.measure_stage, stage, members, GroundingConfig(), args.seconds),
                )
    if "sac" in args.part:
        for members in args.members:
            yield "sac", f"{members} at once", partial(sac.measure_sac, members, SACConfig(), args.seconds)


def benchmark(args: Args) -> Row:
    """Measures, writes `benchmark.json` and `benchmark.md` after every measurement, and returns the record.

    Raises:
      ValueError: options that cannot be (one sentence).
    """
    check(args)
    console = Console(stderr=True)
    record: Row = {
        "command": shlex.join(["python", "-m", "experiments.benchmark", *sys.argv[1:]]),
        "versions": versions(),
        "load_average": [round(x, 1) for x in os.getloadavg()],
        "rows": [],
    }
    rows: list[Row] = []
    planned = list(plan(args))
    for number, (part, label, call) in enumerate(planned, 1):
        console.print(f"[{number}/{len(planned)}] {part}: {label} ...", highlight=False, markup=False)
        rows.append({"part": part, **call()})
        console.print(
            f"    {rows[-1]['rate']:,.0f} a second (first call {rows[-1]['first_call_seconds']:.1f} s)",
            highlight=False,
        )
        record["rows"] = table.ratios(rows)
        files.write_text(args.out / "benchmark.json", json.dumps(record, indent=1))
        files.write_text(args.out / "benchmark.md", table.markdown(record))
    return record


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("benchmark", _benchmark, goes_on=False)


def _benchmark() -> int:
    args = tyro.cli(Args, prog="python -m experiments.benchmark", description=Args.__doc__)
    record = benchmark(args)
    Console().print(Markdown(table.markdown(record)))
    print(f"written: {args.out / 'benchmark.json'} and {args.out / 'benchmark.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
