"""Every supported Python with the oldest and the newest JAX that resolve: an environment for each, and the tests in it.

python -m tests.supported.matrix [ARGUMENTS OF PYTEST]   # `make matrix`; environments are kept in build/matrix

With --resolve as the first argument nothing is installed: it is only said what would be.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "matrix"
PYTHONS = ("3.11", "3.12", "3.13")
UV = [sys.executable, "-m", "uv"]


def oldest_jax() -> str:
    """The least version that pyproject.toml allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (found,) = (m[1] for d in project["dependencies"] if (m := re.match(r"jax>=([\d.]+)", d)))
    return found


def entry(python: str, edge: str, arguments: list[str]) -> str:
    """Makes one environment and runs the tests in it; says in a few words what came of it."""
    home = FOLDER / f"{python}-{edge}"
    pin = FOLDER / f"{edge}.txt"
    FOLDER.mkdir(parents=True, exist_ok=True)
    pin.write_text(f"jax=={oldest_jax()}\n" if edge == "oldest" else "")
    if arguments[:1] == ["--resolve"]:
        resolve = ["pip", "compile", "--quiet", "--python-version", python, "--extra", "dev", "-c", str(pin)]
        done = subprocess.run([*UV, *resolve, "pyproject.toml"], cwd=ROOT, capture_output=True, text=True)
        found = re.search(r"^jax==(\S+)", done.stdout, re.MULTILINE)
        return f"jax {found[1]} resolves" if found else " ".join(done.stderr.split())[-300:]
    if subprocess.run([*UV, "python", "find", "--quiet", python], capture_output=True).returncode:
        return "no such Python on the path"
    steps = [
        [*UV, "venv", "--quiet", "--clear", "--python", python, str(home)],
        [*UV, "pip", "install", "--quiet", "--python", str(home), "-c", str(pin), "-e", ".[dev]"],
        [str(home / "bin" / "python"), "-m", "pytest", "-q", *arguments],
    ]
    for what, command in zip(("made", "installed", "passed"), steps, strict=True):
        if subprocess.run(command, cwd=ROOT).returncode:
            return f"not {what}"
    version = "import jax; print(jax.__version__)"
    jax = subprocess.run(
        [home / "bin" / "python", "-c", version], capture_output=True, text=True
    ).stdout.strip()
    return f"jax {jax}: passed"


def main(arguments: list[str]) -> int:
    """Exit status 0 where every entry passed."""
    told = {(p, e): entry(p, e, arguments) for p in PYTHONS for e in ("oldest", "newest")}
    for (python, edge), said in told.items():
        print(f"Python {python}, {edge} JAX: {said}")
    return int(not all(said.endswith(("passed", "resolves")) for said in told.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
