"""Which recordings are held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.recording import Recording, rows_of


def split(
    recordings: list[Recording], held_out: tuple[str, ...] | None, rng: np.random.Generator
) -> tuple[list[Recording], list[Recording], list[str]]:
    """(training, held-out, warnings). Held out: the given names, else files named `heldout_*`, else a seeded
    third of the recordings, else the last third of the time of a single one."""
    warnings: list[str] = []
    names = [r.name for r in recordings]
    if held_out is not None:
        # people give the file as well as its name
        named = [n if n in names else Path(n).stem for n in held_out]
        missing = [given for given, n in zip(held_out, named, strict=True) if n not in names]
        if missing:
            raise InputError(f"the held-out recording '{missing[0]}' is not among {', '.join(names)}.")
        chosen = set(named)
    else:
        chosen = {n for n in names if n.startswith("heldout_")}
    if not chosen and len(recordings) > 1:
        count = max(1, round(len(recordings) / 3))
        chosen = {names[i] for i in rng.permutation(len(names))[:count]}
    if chosen:
        train = [r for r in recordings if r.name not in chosen]
        held = [r for r in recordings if r.name in chosen]
        if not train:
            raise InputError("every recording is held out; leave at least one for training.")
        return train, held, warnings
    single = recordings[0]
    if single.time.size < 6:
        raise InputError(f"{single.name} has only {single.time.size} rows; record more, or more recordings.")
    row = int(np.searchsorted(single.time, single.time[0] + single.duration * 2 / 3))
    row = min(max(row, 2), single.time.size - 3)
    warnings.append(
        "only one recording: its last third is held out, so the test is weaker than on another run."
    )
    first = rows_of(single, slice(0, row + 1), single.name + "_first")
    last = rows_of(single, slice(row, None), single.name + "_last")
    return [first], [last], warnings
