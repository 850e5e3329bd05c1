"""Rules of the diagnosis switched off, or watched at work, for as long as a context lasts."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any

import numpy as np

from experiments.ablation.gates import Gate
from experiments.ablation.rules import GATES

ENGINE = "mpge_jax.diagnosis"


@contextmanager
def without(gate: Gate) -> Iterator[None]:
    """The engine without one rule."""
    with _in_place({gate.where: partial(gate.off, _function(gate.where))}):
        yield


@contextmanager
def watched(gates: tuple[Gate, ...] = GATES) -> Iterator[set[str]]:
    """The engine as it is; the names of rules that changed any answer of the function where they act are put into the
    set. A rule that changed none of them did not change the diagnosis."""
    acted: set[str] = set()
    looking = [False]
    places = {g.where for g in gates}

    def watching(where: str) -> Callable[..., Any]:
        own, here = _function(where), [g for g in gates if g.where == where]

        @wraps(own)
        def call(*args: Any, **options: Any) -> Any:
            answer = own(*args, **options)
            if looking[0]:
                return answer
            for g in here:
                if g.name in acted:
                    continue
                looking[0] = True
                try:
                    if g.acted is None:
                        acts = not alike(answer, g.off(own, *args, **options))
                    else:
                        acts = g.acted(answer, *args, **options)
                finally:
                    looking[0] = False
                if acts:
                    acted.add(g.name)
            return answer

        return call

    with _in_place({where: watching(where) for where in places}):
        yield acted


def alike(a: Any, b: Any) -> bool:
    """Whether two answers of a function say the same."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(alike, a, b))
    if isinstance(a, float | np.ndarray):
        return bool(np.array_equal(a, b))
    for name in ("hypothesis", "fit"):
        if hasattr(a, name) and hasattr(b, name):
            same = alike(getattr(a, name), getattr(b, name))
            told = [(getattr(x, "tied", None), getattr(x, "better", None)) for x in (a, b)]
            return same and told[0] == told[1]
    return bool(a == b)


def _function(where: str) -> Callable[..., Any]:
    module, name = where.split(":")
    found: Any = importlib.import_module(f"{ENGINE}.{module}")
    for part in name.split("."):
        found = getattr(found, part)
    return found


@contextmanager
def _in_place(new: dict[str, Callable[..., Any]]) -> Iterator[None]:
    """The engine with other functions, wherever a module has imported them."""
    importlib.import_module(ENGINE)
    pairs = []
    for where, function in new.items():
        own, (module, name) = _function(where), where.split(":")
        *classes, name = name.split(".")
        holder = _function(f"{module}:{classes[0]}") if classes else None
        # a partial is no method: it would not be given its object
        called = _as_method(function) if classes else function
        pairs.append((holder, name, own, called))
    for holder, name, own, called in pairs:
        _exchange(holder, name, own, called)
    try:
        yield
    finally:
        # modules that were imported meanwhile hold the substitutes too
        for holder, name, own, called in pairs:
            _exchange(holder, name, called, own)


def _as_method(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, *args, **options: function(self, *args, **options)


def _exchange(holder: Any, name: str, old: Any, new: Any) -> None:
    everyone = [m for m in list(sys.modules.values()) if getattr(m, "__name__", "").startswith(ENGINE)]
    for each in [holder] if holder is not None else everyone:
        if vars(each).get(name) is old:
            setattr(each, name, new)
