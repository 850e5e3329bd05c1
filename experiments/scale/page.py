"""docs/scale.md."""

from pathlib import Path


def markdown(kept: Path) -> str:
    """The page."""
    return ""
