"""Effects of a user's own, registered by a Python file."""

from __future__ import annotations

from pathlib import Path

from mpge_jax import own_code
from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.errors import InputError

_read: dict[str, tuple[Path, bytes]] = {}
"""Identifier -> the file that registered it, and its contents then."""


def load_effects(path: Path | str) -> tuple[str, ...]:
    """Run a file whose classes are decorated with `@register`: the effects are then tried like all others.

    Returns their identifiers; a file that was loaded before is not run again.

    Raises:
        InputError: there is no such file, it cannot be run, registers nothing, or an effect of a name that is taken.
    """
    path, before = Path(path), dict(REGISTRY)
    where = path.resolve()
    known = tuple(name for name, (file, _) in _read.items() if file == where)
    if known:
        return known
    try:
        own_code.load(path)
    except ValueError as error:
        _restore(before)
        raise InputError(f"{error}.") from None
    added = tuple(name for name in REGISTRY if name not in before)
    taken = [name for name, effect in before.items() if REGISTRY.get(name) is not effect]
    if taken or not added:
        _restore(before)
        raise InputError(
            f"{path} registers '{taken[0]}', which exists already; give the effect another id."
            if taken
            else f"{path} registers no effect; put @register (from mpge_jax.diagnosis) above a class of Effect."
        )
    text = where.read_bytes()
    _read.update({name: (where, text) for name in added})
    return added


def file_of(effect: str) -> Path | None:
    """The file that registered an effect; None for one that was not loaded from a file."""
    return _read[effect][0] if effect in _read else None


def contents() -> bytes:
    """All that the loaded files say, for what must not be mixed with other effects' results."""
    return b"".join(name.encode() + text for name, (_, text) in sorted(_read.items()))


def _restore(before: dict[str, Effect]) -> None:
    REGISTRY.clear()
    REGISTRY.update(before)
