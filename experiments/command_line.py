"""Options of logs, which several commands have in common."""

import argparse
from pathlib import Path
from typing import Any

from mpge_jax.diagnosis import load_readers
from mpge_jax.diagnosis.recordings.column_map import load


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
    columns = None if args.map is None else load(args.map)
    for file in args.reader_file or ():
        load_readers(file)
    return columns
