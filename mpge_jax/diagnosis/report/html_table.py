"""A table of the page."""

from __future__ import annotations

from html import escape


def table(head: list[str], rows: list[list[str]]) -> str:
    """HTML of a table. head: plain text. rows: cells as HTML."""
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="overflow"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
