"""Tasks and targets of a user's own, in a Python file: `path/to/file.py:NAME` is a name like any other."""

from pathlib import Path

from envs.types import Task, Variant
from mpge_jax import own_code


def split(name: str) -> tuple[Path, str] | None:
    """The file and the environment that a reference names; None for a plain name."""
    path, colon, plain = name.rpartition(":")
    if colon and path.endswith(".py"):
        return Path(path), plain
    return (Path(name), "") if name.endswith(".py") else None


def defined_in(path: Path) -> list[Task | Variant]:
    """What a file has at its top level: tasks first, then variants.

    Raises:
      ValueError: there is no such file, it cannot be run, or it defines neither.
    """
    module = own_code.load(path)
    # By identity: one thing may have two names in the file.
    values = {id(x): x for x in vars(module).values()}.values()
    found: list[Task | Variant] = [x for x in values if isinstance(x, Task)]
    found += [x for x in values if isinstance(x, Variant)]
    if not found:
        raise ValueError(
            f"{path} defines no envs.Task or envs.Variant at its top level; "
            "`python -m experiments.new robot.xml` writes a file that does"
        )
    return found
