"""Python files of a user's own: effects, tasks. Each is run once in a process."""

import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType

_loaded: dict[Path, ModuleType] = {}


def load(path: Path | str) -> ModuleType:
    """The module that a Python file is; a file that was loaded before is not run again.

    Raises:
      ValueError: there is no such file, or it cannot be run.
    """
    path = Path(path)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise ValueError(f"{path} {what}; give the path of a Python file")
    where = path.resolve()
    if where in _loaded:
        return _loaded[where]
    # A name that no other module has, by which what the file defines can be pickled.
    name = f"{path.stem}_{hashlib.sha256(str(where).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, where)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path} is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(where)]
        line = f" in line {frames[-1].lineno}" if frames else ""
        said = " ".join(str(error).split())
        raise ValueError(f"{path} cannot be used: {type(error).__name__}{line}: {said}") from error
    _loaded[where] = module
    return module
