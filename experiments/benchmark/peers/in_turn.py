"""Ours and a peer's work, measured in turn in one process, so that what else the machine does hits both alike."""

import importlib.util
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax

OURS = "mpge_jax"
Call = Callable[[], Any]
"""Work that is over when the call returns; a number of seconds where another process measured it itself."""


def in_turn(calls: Mapping[str, Call], rounds: int, warm: int = 2) -> dict[str, list[float]]:
    """Seconds of each call in each of `rounds`, after `warm` that compile and are not kept."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(warm + rounds):
        for name, call in calls.items():
            start = time.perf_counter()
            own = call()
            taken = own if isinstance(own, float) else time.perf_counter() - start
            if number >= warm:
                seconds[name].append(taken)
    return seconds


def over(call: Call) -> Call:
    """`call`, whose arrays are there when it returns."""

    def waited() -> None:
        jax.block_until_ready(call())

    return waited


def rates(seconds: Mapping[str, list[float]], amounts: Mapping[str, float]) -> dict[str, float]:
    """Amount a second of each, by the median of its rounds."""
    return {name: amounts[name] / statistics.median(taken) for name, taken in seconds.items()}


def ratio(seconds: Mapping[str, list[float]], amounts: Mapping[str, float], peer: str) -> list[float]:
    """Quartiles of how many times the peer's rate ours is, round by round.

    Both stood next to each other in a round, so that a slow stretch of the machine cancels.
    """
    pairs = zip(seconds[OURS], seconds[peer], strict=True)
    each = [(theirs / ours) * amounts[OURS] / amounts[peer] for ours, theirs in pairs]
    return statistics.quantiles(each, n=4, method="inclusive") if len(each) > 1 else each * 3


def is_there(module: str) -> bool:
    """Whether a peer can be imported here."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False
