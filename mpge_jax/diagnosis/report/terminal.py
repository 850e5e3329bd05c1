"""What the terminal says of a diagnosis: the verdict, the effects, and the errors before and after."""

from __future__ import annotations

import textwrap
from typing import Any

from mpge_jax.diagnosis.report.sentences import effect_rows

WIDTH = 100


def summary(table: dict[str, Any]) -> str:
    """The contents of `diagnosis.json` in lines to read."""
    parts = [textwrap.fill(f"{table['verdict']}: {table['explanation']}", WIDTH)]
    if table["effects"]:
        rows = [["effect", "at", "parameter", "value", "95 % interval", "error without it"]]
        parts.append(_aligned(rows + effect_rows(table)))
    parts += [
        textwrap.fill(f"to tell them apart: {group['separated_by']}", WIDTH) for group in table["ambiguous"]
    ]
    fit = table["fit"]["held_out"]
    if fit["per_joint"]:
        rows = [[f"held-out error ({table['fit']['unit']})", "model as given", "corrected"]]
        errors = dict(fit["per_joint"])
        if len(errors) > 1:
            errors["all together"] = [fit["before"], fit["after"]]
        rows += [[name, *map(_number, pair)] for name, pair in errors.items()]
        parts.append(_aligned(rows))
        of = "the force" if "N" in table["fit"]["unit"] else f"{table['fit']['window_s']:g} s pieces"
        parts.append(f"(rms over {of} of {', '.join(fit['recordings'])})")
    parts += [textwrap.fill(f"warning: {w}", WIDTH) for w in table["warnings"]]
    return "\n\n".join(map(_printable, parts))


def _number(x: float | None) -> str:
    return "unknown" if x is None else f"{x:.3g}"


def _aligned(rows: list[list[str]]) -> str:
    """Rows in columns, without repeating what stands in the first two of the row above."""
    widths = [max(len(r[i]) for r in rows) for i in range(len(rows[0]))]
    lines, above = [], ["", ""]
    for row in rows:
        again = len(row) > 3 and row[:2] == above
        shown = ["", "", *row[2:-1], ""] if again else row
        lines.append("  ".join(x.ljust(w) for x, w in zip(shown, widths, strict=True)).rstrip())
        above = row[:2]
    return "\n".join(lines)


def _printable(text: str) -> str:
    """Names come from files: what a terminal would obey is shown as a question mark."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
