"""What a model description asks the compiler to make: copies, images and terrain, by the numbers that it states.

A line of XML may ask for a million copies of a body or for an image of terabytes. It is refused before MuJoCo makes
them.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from mpge_jax.diagnosis.errors import InputError

MOST_COPIES = 10_000
"""Most copies of one element, copies of copies counted each."""
MOST_POINTS = 1 << 28
"""Most points of an image or of a terrain, and most bytes of memory that a model asks for, in units of 64."""
_COUNTS = {"replicate": "count", "composite": "count", "flexcomp": "count"}
_POINTS = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
_UNITS = {"K": 10, "M": 20, "G": 30, "T": 40, "P": 50, "E": 60}


def check_sizes(file: str, root: ET.Element) -> None:
    """Refuse a description that would fill the memory, or keep the compiler busy for ever.

    Raises:
        InputError: says which element asks for how much.
    """
    # By hand: descriptions may be nested deeper than Python's stack.
    waiting = [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in _COUNTS:
            copies *= max(_product(element.get(_COUNTS[element.tag])), 1.0)
            if copies > MOST_COPIES:
                raise InputError(
                    f"{file}: <{element.tag}> asks for {copies:.4g} copies, more than {MOST_COPIES:,}; make fewer."
                )
        if element.tag in _POINTS:
            points = math.prod(_product(element.get(name)) for name in _POINTS[element.tag])
            if points > MOST_POINTS:
                raise InputError(f"{file}: <{element.tag}> asks for {points:.4g} points; make it smaller.")
        if element.tag == "size" and _bytes(element.get("memory")) > 64.0 * MOST_POINTS:
            raise InputError(
                f"{file}: <size memory={element.get('memory')!r}> is more than a machine has; ask for less."
            )
        waiting += [(child, copies) for child in element]


def _product(text: str | None) -> float:
    """The product of the numbers of an attribute; 1 where it is none, which MuJoCo tells in its own words."""
    try:
        return math.prod(max(float(word), 0.0) for word in (text or "").split())
    except ValueError:
        return 1.0


def _bytes(text: str | None) -> float:
    text = (text or "").strip()
    unit = _UNITS.get(text[-1:].upper(), 0)
    return _product(text[:-1] if unit else text) * 2.0**unit if text else 0.0
