"""Rates: amount / median duration of repeated calls, compilation excluded and reported apart."""

import statistics
import time
from collections.abc import Callable
from typing import Any

import jax

Row = dict[str, Any]


def measure(call: Callable[[], Any], amount: float, seconds: float) -> Row:
    """Calls `call` once to compile, then for `seconds` (at least three times): `rate` is amount / median duration."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    first = time.perf_counter() - start
    durations: list[float] = []
    while len(durations) < 3 or sum(durations) < seconds:
        start = time.perf_counter()
        jax.block_until_ready(call())
        durations.append(time.perf_counter() - start)
    return {
        "rate": amount / statistics.median(durations),
        "calls": len(durations),
        "first_call_seconds": round(first, 1),
    }


def stepper(step: Callable[[Any], Any], state: Any) -> Callable[[], Any]:
    """`step`, each call on the state that the last one returned."""
    held = [state]

    def call() -> Any:
        held[0] = step(held[0])
        return held[0]

    return call
