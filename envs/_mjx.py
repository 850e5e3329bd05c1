"""MJX, imported without what it prints where the optional Warp is not installed."""

import contextlib
import io
import warnings

with contextlib.redirect_stdout(io.StringIO()) as _printed, warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from mujoco import mjx

for _line in _printed.getvalue().splitlines():
    if not _line.startswith(("Failed to import warp:", "Failed to import mujoco_warp:")):
        print(_line)

__all__ = ["mjx"]
