"""Pages of the documentation of which a command writes a part, between two marks, and people the rest."""

from __future__ import annotations

from pathlib import Path

from mpge_jax import files


def put_between(page: Path, begin: str, end: str, text: str) -> None:
    """Replaces what lies between two marks of a Markdown page.

    Raises:
        ValueError: the page does not hold both marks, in this order.
    """
    head, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"{page} has no '{begin}' followed by '{end}'; add both lines where it shall stand.")
    files.write_text(page, f"{head}{begin}\n\n{text.strip()}\n\n{end}{tail}")
