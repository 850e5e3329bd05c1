"""A demonstration of both halves in a few minutes, on one page.

python -m experiments.demo --out DIR

Something is concealed in a simulated arm, drawn from a seed. From recordings of that arm the diagnosis names it and
corrects the simulator, in which a policy is then trained; another is trained in the simulator as it was given. Both are
judged in the arm with what is concealed. Beside that, the log of a real UR10 is diagnosed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import webbrowser
from dataclasses import dataclass
from pathlib import Path

import tyro

from mpge_jax import own_envs as own_envs  # isort: split

from experiments.demo import page
from experiments.demo.simulated import simulated_arm
from experiments.ending import exit_status
from mpge_jax import files

MACHINE = Path(__file__).parent / "ur10"
PAGE = "demo.html"


@dataclass(frozen=True)
class Args:
    """Both halves in a few minutes: a concealed effect found, corrected and trained with; and a real arm's log.

    Attributes:
      out: folder for the page, the recordings and both diagnoses.
      seed: draws what is concealed.
      open: show the page in a browser, where there is one.
      quiet: show no progress.
    """

    out: Path = Path("results/demo")
    seed: int = 0
    open: bool = True
    quiet: bool = False

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}.")


def demo(args: Args) -> Path:
    """Everything, in the folder `args.out`; what is there already is not done again. Returns the page.

    Raises:
      ValueError: the folder holds the demonstration of another seed, or is in use.
      RuntimeError: the diagnosis of the real machine's log failed.
    """
    started = time.monotonic()
    with files.held(args.out):
        kept = args.out / "seed.txt"
        if kept.exists() and kept.read_text() != f"{args.seed}\n":
            raise ValueError(
                f"{args.out} holds the demonstration of seed {kept.read_text().strip()}; give another --out."
            )
        resumed = kept.exists()
        files.write_text(kept, f"{args.seed}\n")
        machine = args.out / "machine"
        # Mostly one thread each: both diagnoses together take little longer than one.
        beside = None if (machine / "diagnosis.json").exists() else _diagnosing(machine)
        try:
            arm = simulated_arm(args.seed, args.out, args.quiet)
            if beside is not None:
                _say(args, "waiting for the diagnosis of the UR10's log")
                if beside.wait() != 0:
                    raise ValueError(f"the diagnosis of {MACHINE} failed: see the lines above.")
        finally:
            if beside is not None and beside.poll() is None:
                beside.terminate()
                beside.wait()
        path = args.out / PAGE
        seconds = None if resumed else time.monotonic() - started
        files.write_text(path, page.page(arm, args.out, MACHINE, seconds))
    return path


def _diagnosing(out: Path) -> subprocess.Popen[bytes]:
    """The diagnosis of the real machine's log, as a process of its own."""
    command = [sys.executable, "-m", "experiments.diagnose", "--model", str(MACHINE / "model.xml")]
    command += ["--recordings", str(MACHINE), "--out", str(out), "--jobs", "1", "--quiet"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def _say(args: Args, text: str) -> None:
    if not args.quiet:
        print(text, file=sys.stderr, flush=True)


def _shown(path: Path) -> bool:
    """Whether a browser was asked for the page; not where nobody looks at a screen."""
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(screen and sys.stdout.isatty() and webbrowser.open(path.resolve().as_uri()))


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0; 2 for bad input; 130 when interrupted."""

    def work() -> int:
        args = tyro.cli(Args, args=argv, prog="python -m experiments.demo")
        path = demo(args)
        print(f"page: {path}")
        if args.open:
            _shown(path)
        return 0

    return exit_status("demo", work)


if __name__ == "__main__":
    raise SystemExit(main())
