"""What commands have in common: options of logs, and how they end."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpge_jax import files


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """`--map` and `--reader-file`, which `columns_of` reads."""
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="renames and converts columns")
    parser.add_argument(
        "--reader-file",
        type=Path,
        nargs="+",
        metavar="FILE.py",
        help="files that register readers of your own for logs",
    )


def columns_of(args: argparse.Namespace) -> dict[str, Any] | None:
    """The content of the map, if there is one; the readers are loaded.

    Raises:
      InputError: a file cannot be used.
    """
    # here, as not every command that ends like these has the time to load what reads logs
    from mpge_jax.diagnosis import load_readers
    from mpge_jax.diagnosis.recordings.column_map import load

    columns = None if args.map is None else load(args.map)
    for file in args.reader_file or ():
        load_readers(file)
    return columns


def exit_status(name: str, work: Callable[[], int]) -> int:
    """Exit status of a command that can go on where it was: that of `work`, 2 for bad input and for what the system
    refuses, 130 when interrupted; each in one sentence."""
    try:
        return work()
    except (ValueError, FileNotFoundError) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(
            f"{name}: cannot go on: {files.reason(error)}; the same command goes on from here",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the same command goes on from here", file=sys.stderr)
        return 130
