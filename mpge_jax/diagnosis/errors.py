"""The one exception for bad input, and the collector for warnings that a report shows."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one sentence: what was wrong, where, and what to do."""
