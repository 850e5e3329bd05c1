"""The one exception for bad input."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one sentence: what was wrong, where, and what to do."""
