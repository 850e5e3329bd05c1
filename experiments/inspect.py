"""Look at a log before it is diagnosed: what was found, what looks wrong, a picture of every column, and a map.

python -m experiments.inspect LOG [LOG ...] --model MODEL.xml [--out DIR] [--map MAP.yaml]
"""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from experiments.command_line import add_log_options, columns_of
from mpge_jax import files
from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.inspection.map_file import map_text
from mpge_jax.diagnosis.inspection.overview import Overview, overviews
from mpge_jax.diagnosis.inspection.picture import draw
from mpge_jax.diagnosis.inspection.summary import summary
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.formats.registry import find_files

TOLD = 3
"""Runs that are told in full; of the others, only what is unlike these."""


def parser() -> argparse.ArgumentParser:
    out = argparse.ArgumentParser(prog="python -m experiments.inspect", description=__doc__.splitlines()[0])
    out.add_argument("log", nargs="+", type=Path, help="logs: .npz, .csv, .h5, .bag, .db3, .mcap, or folders")
    out.add_argument("--model", required=True, type=Path, help="MJCF or URDF file of the model")
    add_log_options(out)
    out.add_argument(
        "--out",
        type=Path,
        default=Path("inspection"),
        help="folder for picture and map (default: %(default)s)",
    )
    return out


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 where every run can be diagnosed, 1 where one cannot, 2 for bad input."""
    args = parser().parse_args(argv)
    try:
        columns = columns_of(args)
        model = compile_variable(load_spec(args.model))
        names = names_of(model)
        found = [(p, o) for p in find_files(args.log) for o in overviews(p, model, names, columns)]
        for _, o in found[:TOLD]:
            print(summary(o, names), end="\n\n")
        for _, o in found[TOLD:]:
            said = (o.problem or "as those above").removeprefix(f"{o.log.name}: ").removesuffix(".")
            print(f"{o.log.name}: {'; '.join([said, *o.doubts])}")
        doubted = [doubt for _, o in found for doubt in o.doubted]
        text = map_text(found[0][1], model, names, doubted)
        written = _write(args.out, [o for _, o in found[:TOLD]], text)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: cannot write to --out {args.out}: {error.strerror or error}.", file=sys.stderr)
        return 2
    print("written: " + ", ".join(map(str, written)))
    unread = [o for _, o in found if o.recording is None]
    if unread and not any(o.for_a_map for o in unread):
        print("It has to be recorded anew or repaired first: no column is left that a map could read.")
        return 1
    # a map to start from lies there, and one that puts units right
    units = any(units for _, units in doubted)
    new_map = units or (unread and args.map is None)
    columns_map = args.out / "map.yaml" if new_map else args.map
    given = [] if columns_map is None else ["--map", str(columns_map)]
    given += ["--reader-file", *map(str, args.reader_file)] if args.reader_file else []
    command = [
        "python",
        "-m",
        "experiments.diagnose",
        "--model",
        args.model,
        "--recordings",
        *args.log,
        *given,
    ]
    when = ""
    if units:
        when = ", once you agree with the units in the map"
    elif unread:
        when = ", once a map says what is missing"
    print(f"to diagnose{when}: " + shlex.join([*map(str, command), "--out", "out"]))
    return int(bool(unread))


def _write(folder: Path, shown: list[Overview], text: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    out = [draw(o, folder / f"columns_{k}.png" if k else folder / "columns.png") for k, o in enumerate(shown)]
    files.write_text(folder / "map.yaml", text)
    return [*out, folder / "map.yaml"]


if __name__ == "__main__":
    raise SystemExit(main())
