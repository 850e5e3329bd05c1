"""What of the model file changes, to be pasted into one's own."""

from __future__ import annotations

import difflib
from html import escape

MOST = 60
"""Lines that are shown."""


def changes(nominal: str, corrected: str) -> list[str]:
    """Lines that the corrected model has in place of the nominal one's: each begins with '-' or '+'."""
    before, after = nominal.splitlines(), corrected.splitlines()
    lines = difflib.unified_diff(before, after, lineterm="", n=0)
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def pasted(nominal: str, corrected: str) -> str:
    """The section of the page; nothing where the model file stays as it is."""
    lines = changes(nominal, corrected)
    if not lines:
        return ""
    more = f"\n... and {len(lines) - MOST} more lines in corrected.xml" if len(lines) > MOST else ""
    return (
        "<h2>What to change in the model file</h2><p>Lines of <code>nominal.xml</code> (-) and what stands in their "
        f"place in <code>corrected.xml</code> (+):</p><pre>{escape(chr(10).join(lines[:MOST]) + more)}</pre>"
    )
