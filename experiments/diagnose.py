"""Say what physics a MuJoCo model lacks, from recordings of the real machine.

python -m experiments.diagnose --model MODEL.xml --recordings PATH [PATH ...] --out DIR
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from experiments.command_line import add_log_options, columns_of
from mpge_jax import files
from mpge_jax.diagnosis import Config, InputError, diagnose, load_effects
from mpge_jax.diagnosis.report.effect_table import vocabulary_table
from mpge_jax.diagnosis.report.terminal import summary


class _ListEffects(argparse.Action):
    """Prints the vocabulary instead of a diagnosis, as `--help` prints the options."""

    def __init__(self, option_strings: list[str], dest: str, **kwargs: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **kwargs)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(vocabulary_table())
        parser.exit()


def parser() -> argparse.ArgumentParser:
    out = argparse.ArgumentParser(prog="python -m experiments.diagnose", description=__doc__.splitlines()[0])
    out.add_argument("--model", required=True, type=Path, help="MJCF or URDF file of the nominal model")
    out.add_argument(
        "--recordings",
        required=True,
        nargs="+",
        type=Path,
        help="recordings (.npz, .csv, .h5, .bag, .db3, .mcap, LeRobot) or folders of them",
    )
    out.add_argument("--out", required=True, type=Path, help="folder for the results")
    out.add_argument(
        "--held-out",
        nargs="+",
        metavar="NAME",
        help="recordings that only test (default: heldout_*, else a quarter)",
    )
    out.add_argument("--effects", nargs="+", metavar="ID", help="effects to try (default: all)")
    out.add_argument(
        "--effects-file",
        type=Path,
        nargs="+",
        metavar="FILE.py",
        help="files that register effects of your own",
    )
    add_log_options(out)
    out.add_argument("--list-effects", action=_ListEffects, help="print the effects that it knows, and exit")
    out.add_argument(
        "--masses-within",
        type=float,
        default=Config.masses_within,
        metavar="SHARE",
        help="by which share the given masses and inertias are off, as a standard deviation; 0: not at all (default: "
        "%(default)s)",
    )
    out.add_argument("--seed", type=int, default=0)
    out.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="threads, one a core at most (default)"
    )
    out.add_argument("--quiet", action="store_true", help="no progress on stderr")
    out.add_argument("--json", action="store_true", help="print diagnosis.json instead of the summary")
    return out


def _config(args: argparse.Namespace) -> Config:
    try:
        return Config(
            effects=tuple(args.effects) if args.effects else None,
            held_out=tuple(args.held_out) if args.held_out else None,
            masses_within=args.masses_within,
            seed=args.seed,
            jobs=min(args.jobs, os.cpu_count() or 1),
            quiet=args.quiet,
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def _check_out(out: Path) -> None:
    """Refuse, before the search and without making it, a folder that cannot be written."""
    folder = next(p for p in (out, *out.absolute().parents) if p.exists() or p.is_symlink())
    if not folder.is_dir():
        raise InputError(f"--out {out} cannot be a folder, because {folder} is a file; give another one.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"--out {out} cannot be written: no permission in {folder}; give another folder.")


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 with a verdict, 2 for bad input, 130 when interrupted."""
    args = parser().parse_args(argv)
    try:
        columns = columns_of(args)
        for file in args.effects_file or ():
            load_effects(file)
        config = _config(args)
        _check_out(args.out)
        progress = args.out / ".progress.json"
        with files.held(args.out):
            result = diagnose(args.model, args.recordings, config, columns, progress)
            if not args.quiet:
                print(f"[{result.seconds:5.0f} s] writing the report", file=sys.stderr, flush=True)
            try:
                result.write(args.out)
                progress.unlink(missing_ok=True)
            except OSError as error:
                raise InputError(f"cannot write to --out {args.out}: {error.strerror or error}.") from None
    except (InputError, files.FolderInUse) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(
            f"error: cannot go on: {files.reason(error)}; the same command goes on from here.",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print("interrupted; run the same command again to go on.", file=sys.stderr)
        return 130
    written = (args.out / "diagnosis.json").read_text()
    if args.json:
        print(written)
    else:
        print(summary(json.loads(written)))
        print(f"\nreport: {args.out / 'report.html'} ({result.seconds:.0f} s)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
