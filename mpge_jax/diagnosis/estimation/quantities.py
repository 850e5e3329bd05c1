"""Quantities in words: as many digits as are known, with their units."""

from __future__ import annotations

from typing import Any

import numpy as np

UNKNOWN = 4.0
"""Width of a component's interval, over the largest component, from which on nothing is known of it."""
BOUNDLESS = 1e3
"""End of an interval, over the value, or the value over the other end, from which on that is all that is known."""
SPOKEN = {"command": "units of its command", "command s/rad": "units of its command per rad/s"}
"""Units in words, where they are no unit by themselves."""


def quantity(entry: dict[str, Any]) -> str:
    """'0.70 N m' or '(0.1, 0, 0.2) m' from a parameter entry."""
    value, unit = entry["value"], entry["unit"]
    low, high = np.atleast_1d(entry["low"]).astype(float), np.atleast_1d(entry["high"]).astype(float)
    width = np.nan_to_num(high - low)
    values = np.atleast_1d(value).astype(float)
    shown_at_all = width <= UNKNOWN * np.nanmax(np.abs(values), initial=0.0)
    # a component far below the largest, or below a hundredth of an interval that holds zero, is nothing
    least = np.maximum(
        0.01 * width * (low * high <= 0), 1e-4 * np.nanmax(np.abs(values), initial=0.0) * (values.size > 1)
    )
    values = np.where(np.abs(values) < least, 0.0, values)
    shown = [digits(v, w) for v, w in zip(values, width, strict=True)]
    if values.size > 1:
        shown = _alike(values, shown)
    if values.size > 1 and shown_at_all.any():
        shown = [text if known else "unknown" for text, known in zip(shown, shown_at_all, strict=True)]
    if values.size == 1 and low[0] > 0 and max(high[0] / values[0], values[0] / low[0]) > BOUNDLESS:
        shown = [f"at least {digits(low[0], 0.1 * low[0])}"]
    text = shown[0] if not isinstance(value, list) else f"({', '.join(shown)})"
    return text if unit == "1" else f"{text} {SPOKEN.get(unit, unit)}"


def _alike(values: np.ndarray, shown: list[str]) -> list[str]:
    """Components of a vector with at most one decimal more than the largest has."""
    largest = shown[int(np.argmax(np.nan_to_num(np.abs(values))))]
    if not np.isfinite(values).any() or "e" in largest:
        return shown
    most = len(largest.partition(".")[2]) + 1
    rounded = [f"{v:.{most}f}" if np.isfinite(v) else text for v, text in zip(values, shown, strict=True)]
    fine = ["e" in text or len(text.partition(".")[2]) > most for text in shown]
    out = [r if f else text for r, f, text in zip(rounded, fine, shown, strict=True)]
    return ["0" if text.strip("-0.") == "" else text for text in out]


def digits(value: float, width: float) -> str:
    """A number up to the first digit in which half its interval of a `width` lies, with two to four digits."""
    if not np.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    size = np.floor(np.log10(abs(value)))
    fine = np.floor(np.log10(0.5 * width)) if width > 0 else size - 3
    digits = int(np.clip(size - fine + 1, 2, 4))
    text = f"{value:.{digits}g}"
    return f"{float(text):.{max(0, int(digits - 1 - size))}f}" if -5 < size < 6 else text


def intervals(entry: dict[str, Any]) -> str:
    """'0.68 to 0.72 N m' from a parameter entry, component by component."""
    low, high = (x if isinstance(x, list) else [x] for x in (entry["low"], entry["high"]))
    known = [(a, b) for a, b in zip(low, high, strict=True) if a is not None and b is not None]
    text = "; ".join(f"{digits(a, b - a)} to {digits(b, b - a)}" for a, b in known)
    unit = "" if entry["unit"] == "1" else SPOKEN.get(entry["unit"], entry["unit"])
    return f"{text} {unit}".rstrip() if text else "not determined"


def clause(text: str) -> str:
    """A sentence as a part of another."""
    text = text.removesuffix(".")
    return text[0].lower() + text[1:] if text.startswith(("The ", "A ", "Gravity ", "Contacts ")) else text
