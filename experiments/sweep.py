"""The main job: compare methods on a target. `python -m experiments.sweep --help` lists what is allowed.

python -m experiments.sweep --task BrokenCheetah --method SPG MPGE-MS --samples 5000 --seeds 3 --preset standard
python -m experiments.sweep --task my_robot.py:MyRobot --target-log my_bag/ --method MPGE-MS diagnosed
"""

import dataclasses
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markdown import Markdown

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs import own_tasks
from envs.registry import nearest
from envs.variants import HIDDEN, PAPER, folded
from experiments import methods, report, runners
from experiments.ending import exit_status
from experiments.inputs import inputs_of
from experiments.methods import METHODS, Cell, LogFiles, logged
from experiments.presets import PRESETS, Preset
from experiments.storage import SweepFolder, plain
from mpge_jax import files
from mpge_jax.rollouts import policies

_TASKS_HELP = (
    "target: "
    + ", ".join(v.name for v in (*PAPER, *HIDDEN))
    + "; one of ODRL's (docs/targets.md); or path/to/file.py:NAME, a target of your own; with --target-log the "
    "simulator, an envs.Task"
)
_METHODS_HELP = "methods, or 'all': " + ", ".join(METHODS)
_PRESETS_HELP = "configuration: " + ", ".join(PRESETS)


@dataclass(frozen=True)
class Args:
    """Carries source policies to a target by several methods, and compares what they return there."""

    task: Annotated[str, tyro.conf.arg(help=_TASKS_HELP)] = "SkewedPendulum"
    method: Annotated[tuple[str, ...], tyro.conf.arg(help=_METHODS_HELP)] = ("all",)
    samples: Annotated[
        tuple[int, ...],
        tyro.conf.arg(
            help="transitions recorded in the target", help_behavior_hint="(default: 1000; of a log all)"
        ),
    ] = ()
    seeds: Annotated[int, tyro.conf.arg(help="number of repetitions, 0 to seeds - 1")] = 2
    preset: Annotated[str, tyro.conf.arg(help=_PRESETS_HELP)] = "quick"
    target_log: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            help="recordings of the target, files or folders, in place of a simulated one",
            help_behavior_hint="(default: none)",
        ),
    ] = ()
    model: Annotated[
        Path | None,
        tyro.conf.arg(
            help="MJCF or URDF of the machine in the log", help_behavior_hint="(default: the task's own)"
        ),
    ] = None
    map: Annotated[Path | None, tyro.conf.arg(help="renames and converts the log's columns")] = None
    reader_file: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            help="files that register readers of your own for the log", help_behavior_hint="(default: none)"
        ),
    ] = ()
    out: Annotated[
        Path | None, tyro.conf.arg(help="output folder", help_behavior_hint="(default: results/TASK-PRESET)")
    ] = None
    backend: Annotated[str, tyro.conf.arg(help="physics: " + ", ".join(envs.BACKENDS))] = "auto"
    dynamics: Annotated[str, tyro.conf.arg(help="inertia of capsules: " + ", ".join(envs.DYNAMICS))] = (
        "mujoco"
    )
    quiet: Annotated[bool, tyro.conf.arg(help="no progress bars")] = False
    options: Annotated[runners.Options, tyro.conf.arg(name="")] = field(default_factory=runners.Options)


@dataclass(frozen=True)
class CellJob:
    """What a cell's job is given.

    Attributes:
      cell: what is asked.
      folder: of the sweep.
      identity: what all its cells share.
      quiet: no progress bars.
      threads: of a diagnosis.
    """

    cell: Cell
    folder: Path
    identity: dict[str, Any]
    quiet: bool
    threads: int


def _check(value: str, known: Sequence[str], option: str) -> str:
    if value not in known:
        near = nearest(value, known)
        hint = "" if near is None else f"; did you mean {near}?"
        raise ValueError(f"--{option} {value} is not known{hint} (allowed: {folded(known)})")
    return value


def cells_of(args: Args) -> tuple[list[Cell], Preset]:
    """The cells that the command line asks for.

    Raises:
      ValueError: an unknown name (the nearest is offered) or a number out of range.
    """
    preset = PRESETS[_check(args.preset, list(PRESETS), "preset")]
    own = own_tasks.split(args.task)
    task = _task_of(args, own)
    if own is not None:
        preset = preset.with_task(envs.source_of(task))
    _check(args.backend, envs.BACKENDS, "backend")
    _check(args.dynamics, envs.DYNAMICS, "dynamics")
    if envs.source_of(task) not in preset.tasks:
        raise ValueError(
            f"preset {preset.name} has no settings for {envs.source_of(task)}, the source of {task}"
        )
    if args.seeds < 1:
        raise ValueError(f"--seeds must be at least 1, got {args.seeds}")
    if not args.target_log and (args.model or args.map or args.reader_file):
        raise ValueError("--model, --map and --reader-file are for reading a log; give it with --target-log")
    known = methods.from_logs() if args.target_log else list(METHODS)
    chosen = known if args.method == ("all",) else [_check(m, list(METHODS), "method") for m in args.method]
    for method in chosen:
        if method not in known:
            raise ValueError(
                f"--method {method} learns nothing from a log, and there is no target to act in but --target-log "
                f"(allowed: {', '.join(known)})"
            )
    log, sizes = _recorded(args, task) if args.target_log else (None, list(args.samples or (1000,)))
    for samples in sizes:
        if samples < preset.policies:
            raise ValueError(
                f"--samples {samples} is smaller than the number of rollout policies, {preset.policies}"
            )
    if own is not None:
        _check_policies(args.task, chosen, preset)
    seeds = tuple(range(args.seeds))
    cells = [
        Cell(task, method, samples, seeds, preset, args.backend, args.dynamics, log)
        for method in dict.fromkeys(chosen)
        for samples in methods.known_samples(sorted(set(sizes)), method)
    ]
    return cells, preset


def _task_of(args: Args, own: tuple[Path, str] | None) -> str:
    """The target, or with a recorded one the simulator; of a file of one's own with its whole path, so that any process
    finds it."""
    plain = envs.plain_name(args.task)
    if own is None:
        is_source = {name: envs.source_of(name) == name for name in envs.names()}
        if args.target_log and not is_source.get(plain, True):
            raise ValueError(
                f"--task {plain} is a simulated target; with --target-log it names the simulator, as "
                f"{envs.source_of(plain)}"
            )
        return _check(
            plain, [n for n, source in is_source.items() if source == bool(args.target_log)], "task"
        )
    task = f"{own[0].resolve()}:{plain}"
    if (envs.source_of(task) == plain) != bool(args.target_log):
        raise ValueError(
            f"--task {args.task} is a simulated target; with --target-log it names the simulator, an envs.Task"
            if args.target_log
            else f"--task {args.task} is a source task: name a target, an envs.Variant of it"
        )
    return task


def _recorded(args: Args, task: str) -> tuple[LogFiles, list[int]]:
    """The log of a real target, and how many of its transitions are learned from."""
    resolve = lambda path: None if path is None else path.resolve()  # noqa: E731
    log = LogFiles(
        tuple(p.resolve() for p in args.target_log),
        resolve(args.model),
        resolve(args.map),
        tuple(p.resolve() for p in args.reader_file),
    )
    available = logged.read(log, envs.source_of(task)).train.size
    return log, logged.checked_samples(args.samples, available)


def _check_policies(task: str, chosen: Sequence[str], preset: Preset) -> None:
    """Raises ValueError where a set of policies that a method starts from was not trained yet."""
    source = envs.source_of(task)
    for kind in dict.fromkeys(METHODS[name].kind for name in chosen):
        path = policies.shipped_path(source, kind, preset.entropy_coefficient)
        if not path.is_file():
            file = task.rpartition(":")[0]
            raise ValueError(
                f"{source} has no {kind} set of policies yet: python -m experiments.pretrain --task {file}:{source} "
                f"--kind {kind}"
            )


def sweep(args: Args) -> int:
    """Runs every cell that has no result yet; returns the number of cells that failed."""
    cells, preset = cells_of(args)
    task, log = cells[0].task, cells[0].files
    kind = args.preset if log is None else f"log-{args.preset}"
    out = args.out or Path("results") / f"{envs.plain_name(task)}-{kind}"
    own = own_tasks.split(task)
    identity = plain(
        {
            "task": task,
            **({} if own is None else {"task_file": zlib.crc32(own[0].read_bytes())}),
            "seeds": args.seeds,
            "preset": preset,
            "backend": args.backend,
            "dynamics": args.dynamics,
            **({} if log is None else {"target_log": logged.fingerprint(log)}),
        }
    )
    runners.check(args.options)
    folder = SweepFolder(out, identity)
    with files.held(out):
        folder.check_inputs(inputs_of(cells))
        return _run(args, cells, preset, folder)


def _run(args: Args, cells: list[Cell], preset: Preset, folder: SweepFolder) -> int:
    console, out, target = Console(stderr=True), folder.path, envs.plain_name(args.task)
    source = envs.source_of(cells[0].task)
    settings = preset.tasks[source]
    console.print(f"{target}, preset {preset.name}, seeds {args.seeds}, results in {out}")
    if (log := cells[0].files) is not None:
        left_out = [name for name in METHODS if name not in methods.from_logs()]
        for note in (*logged.told(log, source), f"not possible from a log: {', '.join(left_out)}"):
            console.print(note, highlight=False, markup=False)
    for line in settings_in_lines(settings):
        console.print(line, highlight=False, markup=False)
    steps = {
        name: config.simulator_steps
        for name, method in METHODS.items()
        if (config := methods.grounding_config(method, preset, source)) is not None
    }
    # Bars of several processes would write over each other.
    quiet = args.quiet or not args.options.in_this_process
    by_name = {f"{cell.method}-{cell.samples}": cell for cell in cells}
    # With its whole path, so that any process finds it.
    whole = out.resolve()
    jobs = [
        runners.Job(
            name,
            run_cell,
            CellJob(cell, whole, folder.identity, quiet, args.options.threads),
            folder.result(*_key(cell)).resolve(),
        )
        for name, cell in by_name.items()
    ]
    failures: dict[str, str] = {}
    for number, ended in enumerate(runners.run(jobs, args.options, out / "jobs"), 1):
        cell = by_name[ended.name]
        label = f"[{number}/{len(cells)}] {cell.method}" + (
            f", {cell.samples} samples" if cell.samples else ""
        )
        if ended.state == "before":
            console.print(f"{label}: done before", highlight=False)
            continue
        if ended.state == "failed":
            # All lines of the error are in the cell's error.json.
            failures[ended.name] = ended.reason
            folder.save_error(*_key(cell), ended.details or ended.reason)
            console.print(f"{label}: failed, {ended.reason}", highlight=False, markup=False)
            continue
        rows = folder.rows_of(*_key(cell))
        seconds = 0.0 if ended.cost is None else ended.cost.seconds
        console.print(f"{label}: {report.in_short(rows)}, {seconds:.0f} s", highlight=False)
        write_report(folder, target, steps, failures)
    write_report(folder, target, steps, failures)
    Console().print(Markdown((out / "results.md").read_text()))
    console.print(f"tables and pictures: {out}", highlight=False)
    return len(failures)


def settings_in_lines(settings: Any, name: str = "settings") -> Iterator[str]:
    """A configuration, a line for each group of its settings, which a terminal of any width wraps between words."""
    values = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}
    groups = {key: value for key, value in values.items() if dataclasses.is_dataclass(value)}
    own = [f"{key}={value!r}".replace(" ", "") for key, value in values.items() if key not in groups]
    yield f"{name}: {' '.join(own)}"
    for key, value in groups.items():
        yield from settings_in_lines(value, key)


def _key(cell: Cell) -> tuple[str, int]:
    return cell.method, cell.samples


def run_cell(given: CellJob) -> None:
    """Runs a cell and keeps what it gave; the work of a job."""
    started = time.monotonic()
    cell, folder = given.cell, SweepFolder(given.folder, given.identity)
    # what an interrupted run had taken is not known
    resumed = {"resumed": True} if folder.begun(*_key(cell)) else {}
    outcome = methods.run(cell, folder.cell(*_key(cell)), given.quiet, given.threads)
    spent = {"seconds": time.monotonic() - started, "grounding_seconds": outcome.grounding_seconds}
    share = {name: round(value / len(outcome.rows), 1) for name, value in spent.items()}
    rows = [{**row, **share, **resumed} for row in outcome.rows]
    folder.save_cell(*_key(cell), rows, outcome.curve, outcome.transformers, outcome.agents)


def write_report(folder: SweepFolder, task: str, steps: dict[str, int], failures: dict[str, str]) -> None:
    """Tables and pictures of what is there so far."""
    rows = folder.rows()
    folder.write_tables(report.markdown(rows, list(METHODS), failures))
    if any("return_stochastic" in row for row in rows):
        report.returns_figure(rows, folder.path / "returns.png", task)
    curves = folder.curves()
    if any("error_uniform" in curve for curve in curves.values()):
        report.errors_figure(curves, folder.path / "errors.png", task, steps)


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        return 1 if sweep(tyro.cli(Args, prog="python -m experiments.sweep", description=Args.__doc__)) else 0

    return exit_status("sweep", work)


if __name__ == "__main__":
    sys.exit(main())
