"""Writing files in one step: a reader sees the old or the new one, never half of it. And reading arrays."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


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
    """All arrays of an npz file; pickles are refused. Of a damaged file, numpy raises errors of many kinds."""
    # Opened here, because numpy leaves a file open that turns out to be damaged.
    with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}
