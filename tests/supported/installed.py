"""The wheel in an environment of its own: installed there, it runs the README's library examples in an empty folder.

python -m tests.supported.installed [FOLDER]   # `make installed`; the folder is kept
"""

import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run(*command: str | Path, cwd: Path) -> None:
    """Runs a command that finds nothing of this checkout by itself."""
    print("==", *command, flush=True)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    subprocess.run([str(word) for word in command], cwd=cwd, env=environment, check=True)


def main(folder: Path) -> int:
    """Exit status 0 where all examples ran."""
    folder.mkdir(parents=True, exist_ok=True)
    empty, python = folder / "empty", folder / "venv" / "bin" / "python"
    empty.mkdir(exist_ok=True)
    try:
        run(
            sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", ROOT, "-w", folder,
            cwd=empty,
        )  # fmt: skip
        (wheel,) = folder.glob("mpge_jax-*.whl")
        venv.create(folder / "venv", with_pip=True, clear=True)
        run(python, "-m", "pip", "install", "--quiet", "-c", ROOT / "constraints.txt", wheel, cwd=empty)
        where = "import envs, experiments, mpge_jax; assert 'site-packages' in mpge_jax.__file__"
        run(python, "-c", where, cwd=empty)
        blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
        (empty / "examples.py").write_text("\n".join(blocks))
        run(python, "examples.py", cwd=empty)
        run(folder / "venv" / "bin" / "mpge-diagnose", "--list-effects", cwd=empty)
    except subprocess.CalledProcessError as error:
        print(f"failed with {error.returncode}: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        return 1
    print(f"the wheel runs {len(blocks)} examples of the README in {empty}")
    return 0


if __name__ == "__main__":
    sys.exit(
        main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="installed-")).resolve())
    )
