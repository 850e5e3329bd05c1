"""Which recordings train, which ones choose between effects, and which ones only test."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.recording import Recording, rows_of

Part = Literal["train", "choice", "test"]
PARTS: tuple[Part, ...] = ("train", "choice", "test")
TEST, CHOICE = 1 / 4, 1 / 3
"""Share of what was recorded that tests, and share of the rest that chooses."""
WHOLE = 4
"""Recordings from which on whole ones test; of fewer, the last stretch of each does."""
LONG = 60
"""Rows of the usual recording from which on the last stretch of each chooses: of recordings that were made to show one
joint each, no part of them would show what the others do."""
DRAWS, ABOUT = 100, 0.1
"""Draws of whole recordings, and how far their duration may be from their share."""
FEWEST_ROWS = 3
"""Rows of a stretch."""


@dataclass(frozen=True)
class ThreeParts:
    """Recordings by what they are for.

    Attributes:
        train: parameters are fitted to them. choice: effects are chosen by them. test: nothing looks at them before the
            errors that are reported are computed. warnings: what a reader should know of how they were divided.
    """

    train: list[Recording]
    choice: list[Recording]
    test: list[Recording]
    warnings: list[str] = field(default_factory=list)


def three_parts(
    recordings: list[Recording],
    held_out: tuple[str, ...] | None,
    rng: np.random.Generator,
    chosen: bool = True,
) -> ThreeParts:
    """Divide recordings.

    Those that test: the names given, else files named `heldout_*`, else a seeded quarter, else the last quarter of each
    of a few. Of the others the last third of each chooses, or a seeded third of short ones.

    Args:
        chosen: whether effects are chosen by other recordings than those they are fitted to; else none are set apart.

    Raises:
        InputError: a name is not among them, or nothing is left to train on.
    """
    warnings: list[str] = []
    test, others = _test(recordings, _named(recordings, held_out), rng, warnings)
    if not others:
        raise InputError("every recording is held out; leave at least one for training.")
    if not chosen:
        return ThreeParts(others, [], test, warnings)
    short = float(np.median([r.time.size for r in others])) < LONG and len(others) > 1
    train, choice = _apart(others, "choice", CHOICE, short, rng)
    if not train or not choice:
        few = recordings[0]
        raise InputError(f"{few.name} has only {few.time.size} rows; record more, or more recordings.")
    return ThreeParts(train, choice, test, warnings)


def _named(recordings: list[Recording], held_out: tuple[str, ...] | None) -> set[str]:
    names = [r.name for r in recordings]
    if held_out is None:
        return {n for n in names if n.startswith("heldout_")}
    # people give the file as well as its name
    named = [n if n in names else Path(n).stem for n in held_out]
    missing = [given for given, n in zip(held_out, named, strict=True) if n not in names]
    if missing:
        raise InputError(f"the held-out recording '{missing[0]}' is not among {', '.join(names)}.")
    return set(named)


def _test(
    recordings: list[Recording], named: set[str], rng: np.random.Generator, warnings: list[str]
) -> tuple[list[Recording], list[Recording]]:
    """Those that test, and the others."""
    if named:
        return [r for r in recordings if r.name in named], [r for r in recordings if r.name not in named]
    others, test = _apart(recordings, "test", TEST, len(recordings) >= WHOLE, rng)
    if not test:
        few = recordings[0]
        raise InputError(f"{few.name} has only {few.time.size} rows; record more, or more recordings.")
    if len(recordings) < WHOLE:
        which = "only one recording: its last" if len(recordings) == 1 else "few recordings: each one's last"
        warnings.append(f"{which} quarter is held out, so the test is weaker than on another run.")
    return test, others


def _apart(
    recordings: list[Recording], part: Part, share: float, whole: bool, rng: np.random.Generator
) -> tuple[list[Recording], list[Recording]]:
    """Recordings, and a share of them set apart: `whole` ones, or the last stretch of each (`run_test` of `run`)."""
    if whole:
        chosen = _share_of([r.duration for r in recordings], share, rng)
        parts = ([r for k, r in enumerate(recordings) if (k in chosen) is apart] for apart in (False, True))
        return next(parts), next(parts)
    cut = [_cut(r, share, f"{r.name}_{part}") for r in recordings]
    return [first for first, _ in cut], [last for _, last in cut if last is not None]


def _share_of(durations: list[float], share: float, rng: np.random.Generator) -> set[int]:
    """Indices of a share of the recordings that together last about as much of the time: the first of several draws
    that does, else the nearest."""
    count = max(1, round(len(durations) * share))
    wanted = count * float(np.mean(durations))
    best: set[int] = set()
    nearest = np.inf
    for _ in range(DRAWS):
        drawn = set(rng.permutation(len(durations))[:count].tolist())
        off = abs(sum(durations[k] for k in drawn) - wanted)
        if off < nearest:
            best, nearest = drawn, off
        if off <= ABOUT * wanted:
            break
    return best


def _cut(r: Recording, share: float, name: str) -> tuple[Recording, Recording | None]:
    """A recording and its last stretch, of that name; None for that where the recording is too short. The stretch keeps
    what came before it, which says how it began."""
    rows = r.time.size
    if rows < 2 * FEWEST_ROWS:
        return r, None
    row = int(np.searchsorted(r.time, r.time[0] + r.duration * (1 - share)))
    row = min(max(row, FEWEST_ROWS - 1), rows - FEWEST_ROWS)
    last = replace(r, name=name, part_of=r.log, before=float(r.time[row] - r.time[0]))
    return rows_of(r, slice(0, row + 1), r.name), last
