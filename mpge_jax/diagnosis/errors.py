"""The one exception for bad input."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one sentence: what was wrong, where, and what to do.

    What cannot be printed (a line break in a column's name) is written as its escape, so that the sentence
    stays one line whatever the input was called.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in sentence))
