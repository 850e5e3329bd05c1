"""Refuses another package of the name `envs` (a folder where Python was started, say) in place of this project's."""

import sys
from pathlib import Path

import envs

_OURS = Path(__file__).resolve().parents[1] / "envs"
_FOUND = Path(next(iter(getattr(envs, "__path__", [envs.__file__])))).resolve()
if _FOUND != _OURS:
    _SAID = (
        f"{_FOUND} stands before this library's own package 'envs' ({_OURS}): start Python in another folder, or give "
        "yours another name."
    )
    _running = getattr(sys.modules["__main__"], "__spec__", None)
    if _running is not None and _running.name.startswith("experiments."):
        # a command, by `python -m`: nobody is there to catch an error, and a traceback says no more
        print(_SAID, file=sys.stderr)
        raise SystemExit(2)
    raise ImportError(_SAID)
