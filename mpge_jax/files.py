"""Writing files in one step: a reader sees the old or the new one, never half of it. Reading arrays; held folders."""

import contextlib
import fcntl
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

MOST_BYTES = 4 << 30
"""Most bytes that an npz file may have unpacked."""


def write_text(path: Path | str, text: str) -> None:
    """Writes a text file, and the folders that lead to it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def write_npz(path: Path | str, arrays: Mapping[str, Any]) -> None:
    """Writes a compressed npz file without pickles, and the folders that lead to it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    # Through `Any`: the stubs take every keyword for the flag `allow_pickle`.
    named: Any = {name: np.asarray(value) for name, value in arrays.items()}
    with partial.open("wb") as file:
        np.savez_compressed(file, **named)
    os.replace(partial, path)


def read_npz(path: Path | str) -> dict[str, np.ndarray]:
    """All arrays of an npz file; pickles are refused, and so is what has more than `MOST_BYTES` when it is unpacked. Of
    a damaged file, numpy raises errors of many kinds."""
    # Opened here, because numpy leaves a file open that turns out to be damaged.
    with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        size = sum(member.file_size for member in arrays.zip.infolist())
        if size > MOST_BYTES:
            raise ValueError(f"unpacked it would have {size / 1e9:.3g} GB")
        return {name: arrays[name] for name in arrays.files}


def reason(error: OSError) -> str:
    """What went wrong with which file, for a message: a full disk, a file that may not be written."""
    if error.strerror is None:
        return str(error)
    where = "" if error.filename is None else f"{error.filename}: "
    return f"{where}{error.strerror}"


class FolderInUse(ValueError):
    """Another run holds a folder."""


@contextlib.contextmanager
def held(folder: Path | str) -> Iterator[None]:
    """Makes a folder and keeps other runs out of it, until the end of the block or of the process, however it ends.

    A folder that was made and is empty at the end is taken away again.

    Raises:
      FolderInUse: another run holds it.
    """
    folder = Path(folder)
    made = [f for f in (folder, *folder.parents) if not f.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    lock = folder / ".lock"
    while True:
        file = os.open(lock, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(file, 32).decode() or "unknown"
            os.close(file)
            raise FolderInUse(
                f"{folder} is in use by another run (process {holder}): wait for its end, or give another folder"
            ) from None
        # A run that ended in between has taken its lock away: what was locked then is no longer that file.
        if _is_at(file, lock):
            break
        os.close(file)
    try:
        os.truncate(file, 0)
        os.write(file, str(os.getpid()).encode())
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)
        with contextlib.suppress(OSError):
            for each in made:
                each.rmdir()


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
