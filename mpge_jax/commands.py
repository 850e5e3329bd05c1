"""What the console scripts start: a command of `experiments`, or one sentence where that is another's package."""

import importlib
import importlib.util
import sys
from functools import partial
from pathlib import Path

_HOME = Path(__file__).resolve().parents[1]
_WITHOUT_ENVS = ("diagnose", "fleet", "inspect")
_PACKAGES = ("benchmark", "demo", "fleet")


def stranger(package: str) -> Path | None:
    """Where another package of that name lies that Python finds in place of this project's; None where it is ours."""
    spec = importlib.util.find_spec(package)
    if spec is None:
        return Path(package)
    found = [Path(p).resolve() for p in spec.submodule_search_locations or [spec.origin or package]]
    return None if _HOME / package in found[:1] else found[0]


def start(command: str) -> int:
    """Runs a command and returns its exit status; 2, with one sentence, where a folder of its packages' names is in the
    way."""
    for package in ("experiments",) if command in _WITHOUT_ENVS else ("experiments", "envs"):
        other = stranger(package)
        if other is not None:
            print(
                f"mpge-{command}: {other} stands before this library's own package '{package}' ({_HOME / package}): "
                "take its folder off PYTHONPATH, or give yours another name.",
                file=sys.stderr,
            )
            return 2
    module = importlib.import_module(f"experiments.{command}" + ".__main__" * (command in _PACKAGES))
    return int(module.command() if hasattr(module, "command") else module.main())


demo, diagnose, fleet, inspect, new, pretrain, sweep = (
    partial(start, name) for name in ("demo", "diagnose", "fleet", "inspect", "new", "pretrain", "sweep")
)
benchmark = partial(start, "benchmark")
