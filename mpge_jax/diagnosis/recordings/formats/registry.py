"""Which format a path is in, and which files and folders are recordings."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats import hdf5, lerobot, rosbag
from mpge_jax.diagnosis.recordings.formats.tables import Log

ARRAYS = (".npz", ".csv")
"""Endings of the two formats that need no package."""
OTHER_FORMATS = (".mat", ".pkl", ".pickle", ".npy", ".tsv", ".parquet")
"""Endings of logs that are not read."""


@dataclass(frozen=True)
class Format:
    """A way to write logs: what files end in, how a folder is known, and what reads either. own: by a user's file."""

    name: str
    endings: tuple[str, ...]
    is_folder: Callable[[Path], bool]
    read: Callable[[Path], list[Log]]
    own: bool = False


FORMATS = (
    Format("LeRobot", (), lerobot.is_dataset, lerobot.read),
    Format("HDF5", (".h5", ".hdf5"), lambda p: hdf5.main_file(p).is_file(), hdf5.read),
    Format("ROS bag", (".bag", ".db3", ".mcap"), rosbag.is_bag, rosbag.read),
)
OWN: list[Format] = []
"""Those that a user's file has added (`own_readers`)."""


def formats() -> tuple[Format, ...]:
    """All that are read beside `ARRAYS`."""
    return (*OWN, *FORMATS)


def endings() -> tuple[str, ...]:
    """Endings of their files."""
    return tuple(e for f in formats() for e in f.endings)


def format_of(path: Path) -> Format | None:
    """The format of a file or a folder that is one log; None for .npz, .csv and what is not read."""
    if path.is_dir():
        try:
            return next((f for f in formats() if f.is_folder(path)), None)
        except PermissionError:
            return None
    return next((f for f in formats() if path.suffix.lower() in f.endings), None)


def read_logs(path: Path) -> list[Log]:
    """The runs in a file or folder.

    Raises:
        InputError: it is damaged, or the package that reads it is missing.
    """
    found = format_of(path)
    if found is None:
        raise InputError(f"{path.name} is in no format that is read (.npz, .csv, {', '.join(endings())}).")
    try:
        return found.read(path)
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(f"cannot read {path.name}: {error.strerror}.") from None
    except Exception as error:  # each of the packages has exceptions of its own for damaged bytes
        what = " ".join(str(error).split())[:150]
        if found.own:
            line = traceback.extract_tb(error.__traceback__)[-1]
            raise InputError(
                f"cannot read {path.name}: the reader '{found.name}' failed with {type(error).__name__} in line "
                f"{line.lineno} of {Path(line.filename).name}: {what}."
            ) from None
        raise InputError(
            f"cannot read {path.name} as {found.name}: it is damaged or cut off ({type(error).__name__}"
            f"{': ' + what if what else ''})."
        ) from None


def find_files(paths: Iterable[str | Path]) -> list[Path]:
    """Recordings of the given files and folders, sorted by name; other files in a folder are left alone.

    A folder's .npz and .csv files are its recordings. Where it has none, its logs in other formats are.
    """
    files: list[Path] = []
    for entry in map(Path, paths):
        if entry.is_dir():
            files += _inside(entry)
        elif entry.is_file():
            if entry.suffix.lower() not in (*ARRAYS, *endings()):
                raise InputError(f"{entry.name} is neither .npz nor .csv nor {', '.join(endings())}.")
            files.append(entry)
        else:
            raise InputError(f"the recording {entry} does not exist.")
    # a link keeps its own name, which may say that it is held out
    unique: dict[Path, Path] = {}
    for path in files:
        unique.setdefault(path.resolve(), path)
    return list(unique.values())


def _inside(folder: Path) -> list[Path]:
    arrays = sorted(p for p in folder.iterdir() if p.suffix.lower() in ARRAYS and p.is_file())
    if arrays:
        return [p for p in arrays if p.name != "next_experiment.npz"]
    if format_of(folder):
        return [folder]
    logs = sorted(p for p in folder.iterdir() if format_of(p))
    if not logs:
        other = ", ".join(other_logs(folder))
        raise InputError(
            f"the folder {folder} holds no .npz or .csv file"
            + (f" (but {other})." if other else f", and no {', '.join(endings())} or LeRobot folder either.")
        )
    return logs


def other_logs(folder: Path) -> list[str]:
    """Names of what looks like recordings in a folder, and is not read beside its .npz and .csv files."""
    others = (*endings(), *OTHER_FORMATS)
    return sorted(p.name for p in folder.iterdir() if p.suffix.lower() in others and p.is_file())
