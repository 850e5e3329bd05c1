"""Refuses another package of the name `envs` (a folder where Python was started, say) in place of this project's."""

from pathlib import Path

import envs

_OURS = Path(__file__).resolve().parents[1] / "envs"
_FOUND = Path(next(iter(getattr(envs, "__path__", [envs.__file__])))).resolve()
if _FOUND != _OURS:
    raise ImportError(
        f"{_FOUND} stands before this library's own package 'envs' ({_OURS}): start Python in another folder, or give "
        "yours another name."
    )
