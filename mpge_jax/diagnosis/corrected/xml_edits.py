"""Changes of single attributes in the text of an XML file: all else, comments and layout too, stays as it was."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr


@dataclass
class Element:
    """An element and where its first tag lies in the file [start, end)."""

    tag: str
    attributes: dict[str, str]
    start: int
    end: int
    children: list[Element] = field(default_factory=list)

    def iter(self, *tags: str) -> Iterator[Element]:
        """This element and all below it, in the file's order: those of the given tags, or all."""
        if not tags or self.tag in tags:
            yield self
        for child in self.children:
            yield from child.iter(*tags)

    def child(self, tag: str) -> Element | None:
        return next((c for c in self.children if c.tag == tag), None)


class XmlText:
    """The text of an XML file, edited in place.

    Raises:
        ExpatError: the text is not well-formed.
    """

    def __init__(self, text: bytes) -> None:
        self.text = text
        self._edits: list[tuple[int, int, bytes]] = []
        stack: list[Element] = []
        roots: list[Element] = []
        parser = expat.ParserCreate()

        def begin(tag: str, attributes: dict[str, str]) -> None:
            start = parser.CurrentByteIndex
            element = Element(tag, dict(attributes), start, _end_of_tag(text, start))
            (stack[-1].children if stack else roots).append(element)
            stack.append(element)

        parser.StartElementHandler = begin
        parser.EndElementHandler = lambda _tag: stack.pop()
        parser.Parse(text, True)
        self.root = roots[0]

    def set(
        self, element: Element, values: Mapping[str, str], drop: tuple[str, ...] = (), tag: str | None = None
    ) -> None:
        """Give an element attributes, take others away, and perhaps another tag (of an element without contents)."""
        old = self.text[element.start : element.end].decode()
        new = old
        for name in drop:
            new = re.sub(rf"\s+{re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')", "", new)
        for name, value in values.items():
            pattern = rf"(\s{re.escape(name)}\s*=\s*)(\"[^\"]*\"|'[^']*')"
            quoted = quoteattr(value)
            new, found = re.subn(pattern, lambda m, q=quoted: m[1] + q, new)  # type: ignore[misc]
            if not found:
                new = re.sub(r"\s*(/?>)$", lambda m, n=name, q=quoted: f" {n}={q}{m[1]}", new)  # type: ignore[misc]
        if tag is not None:
            new = f"<{tag}" + new[1 + len(element.tag) :]
        self._edits.append((element.start, element.end, new.encode()))

    def is_closed(self, element: Element) -> bool:
        """Whether the element ends with its first tag."""
        return self.text[: element.end].endswith(b"/>")

    def insert(self, parent: Element, child: str) -> None:
        """Put an element, given as text, before all others in `parent`."""
        line = self.text[self.text.rfind(b"\n", 0, parent.start) + 1 : parent.start]
        margin = line[: len(line) - len(line.lstrip())].decode() if not line.strip() else ""
        inner = f"\n{margin}  {child}"
        if self.is_closed(parent):
            opened = self.text[parent.start : parent.end - 2].decode().rstrip()
            both = f"{opened}>{inner}\n{margin}</{parent.tag}>"
            self._edits.append((parent.start, parent.end, both.encode()))
        else:
            self._edits.append((parent.end, parent.end, inner.encode()))

    def result(self) -> bytes:
        """The edited text. An element is edited once at most; what is put into it may be more."""
        out, at = [], 0
        for start, end, new in sorted(self._edits, key=lambda edit: edit[:2]):
            out += [self.text[at:start], new]
            at = end
        return b"".join([*out, self.text[at:]])


def written(tag: str, attributes: Mapping[str, str]) -> str:
    """An element without contents."""
    return f"<{tag} {' '.join(f'{name}={quoteattr(value)}' for name, value in attributes.items())}/>"


def _end_of_tag(text: bytes, start: int) -> int:
    quote = b""
    for i in range(start, len(text)):
        c = text[i : i + 1]
        if quote:
            quote = b"" if c == quote else quote
        elif c in (b'"', b"'"):
            quote = c
        elif c == b">":
            return i + 1
    return len(text)
