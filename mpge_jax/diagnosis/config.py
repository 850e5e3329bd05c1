"""Settings of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any

KINDS: dict[str, tuple[Any, str]] = {
    "int": (Integral, "a whole number"),
    "int | None": (Integral | None, "a whole number or None"),
    "float": (Real, "a number"),
    "bool": (bool, "True or False"),
    "tuple[str, ...] | None": (tuple | list | None, "a tuple of names or None"),
}


@dataclass(frozen=True)
class Config:
    """How a diagnosis is made.

    Attributes:
        effects: identifiers to try (None: all). held_out: names of recordings that only test (None: by the rule).
        seed: seed of every random choice. jobs: threads. decide_s, report_s: window lengths in seconds.
        masses_within: by which share the given masses and inertias are off, as a standard deviation (0: not at all).
        train_windows, choice_windows: most windows used for deciding. max_effects: most effects looked for.
        quiet: no progress on stderr.
    """

    effects: tuple[str, ...] | None = None
    held_out: tuple[str, ...] | None = None
    seed: int = 0
    jobs: int = 2
    decide_s: float = 0.25
    report_s: float = 0.5
    masses_within: float = 0.03
    train_windows: int = 40
    choice_windows: int = 150
    max_effects: int | None = None
    quiet: bool = False

    def __post_init__(self) -> None:
        for f in fields(self):
            value, (type_, words) = getattr(self, f.name), KINDS.get(str(f.type), (object, ""))
            if not isinstance(value, type_):
                raise ValueError(f"{f.name} must be {words}, got {value!r}.")
        if not 0.02 <= self.decide_s <= 5 or not 0.02 <= self.report_s <= 5:
            raise ValueError("window lengths must lie between 0.02 and 5 seconds.")
        if not 0.0 <= self.masses_within <= 0.3:
            raise ValueError(f"masses_within must lie between 0 and 0.3, got {self.masses_within}.")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}.")
        if self.jobs < 1:
            raise ValueError(f"jobs must be at least 1, got {self.jobs}.")
        if self.train_windows < 4 or self.choice_windows < 2:
            raise ValueError("at least 4 training and 2 windows to choose by are needed.")
        if self.max_effects is not None and self.max_effects < 0:
            raise ValueError(f"max_effects must not be negative, got {self.max_effects}.")
