"""How commands end: each in one sentence, with its exit status."""

import sys
from collections.abc import Callable

from mpge_jax import files


def exit_status(name: str, work: Callable[[], int], goes_on: bool = True) -> int:
    """Exit status of a command: that of `work`, 2 for bad input and for what the system refuses, 130 when interrupted;
    each in one sentence.

    Args:
      goes_on: whether the same command goes on where it was.
    """
    rest = "; the same command goes on from here" if goes_on else ""
    try:
        return work()
    except ValueError as error:
        said, status = str(error), 2
    except OSError as error:
        # what the system says has a number, what a command says of a file that is not there has none
        said = str(error) if error.errno is None else f"cannot go on: {files.reason(error)}{rest}"
        status = 2
    except KeyboardInterrupt:
        said, status = f"interrupted{rest}", 130
    print(f"{name}: {said}", file=sys.stderr)
    return status
