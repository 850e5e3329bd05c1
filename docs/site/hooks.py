"""What MkDocs builds besides the pages of `docs/`: the start page, which is the README, and the page of effects."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import effects_page

ROOT = Path(__file__).parents[2]
GENERATED = ("index.md", "effects.md")


def on_files(files: Any, config: Any) -> Any:
    """Adds the generated pages."""
    from mkdocs.structure.files import File

    for name, text in zip(GENERATED, (_start(), effects_page.page()), strict=True):
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links that lead out of `docs/`, to code or data of the repository, become the names of what they lead to."""
    del page, config, files
    return re.sub(r"\[([^\]]+)\]\(\.\./(?!\.\.)([^)#]*)[^)]*\)", _named, markdown)


def _named(link: re.Match[str]) -> str:
    text, target = link.groups()
    return text if text.strip("`") == target else f"{text} (`{target}`)"


def _start() -> str:
    """The README, whose links into `docs/` are links between pages here."""
    text = (ROOT / "README.md").read_text("utf-8")
    text = re.sub(r"\]\(docs/([^)]*)\)", r"](\1)", text)
    out = re.sub(r"\]\((?!https?:|#)([^)]*)\)", lambda m: m[0] if _in_docs(m[1]) else f"](../{m[1]})", text)
    return re.sub(r"\]\(machines\)", "](machines/ur10_bag.md)", out)


def _in_docs(target: str) -> bool:
    return (ROOT / "docs" / target.partition("#")[0]).exists() or target.partition("#")[0] in GENERATED
