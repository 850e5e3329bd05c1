"""Grounding, learning included, beside GAIL with TRPO by `imitation`, which runs in a Python of its own."""

import subprocess
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from experiments.benchmark.grounding import iteration
from experiments.benchmark.peers.in_turn import Call, over
from mpge_jax.grounding.config import GroundingConfig

PEER = "imitation (GAIL, TRPO)"
PYTHON = Path("build/imitation/bin/python")
"""It asks for gymnasium below 1, so that it cannot stand beside this project."""
INSTALL = (
    "python -m venv build/imitation && build/imitation/bin/pip install imitation==1.0.1 'sb3-contrib<2.3' "
    "'gymnasium[mujoco]'"
)
WORKER = Path(__file__).with_name("gail_worker.py")
PAPER = GroundingConfig(discriminator_updates=4, discriminator_batch=512)
"""The paper's networks, batch and updates of D, in 64 simulators."""


def ours(config: GroundingConfig = PAPER) -> Call:
    """One iteration of grounding on the C engine."""
    return over(iteration("c", 1, config))


class Gail(AbstractContextManager[Call]):
    """The peer's process: each call makes as many steps as one of our iterations, and returns their seconds."""

    def __init__(self, python: Path = PYTHON):
        self._process = subprocess.Popen(
            [str(python), str(WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={"PATH": "/usr/bin:/bin"},
        )

    def __enter__(self) -> Call:
        return self._call

    def __exit__(self, *_: Any) -> None:
        self._process.kill()
        self._process.communicate()

    def _call(self) -> float:
        given, said = self._process.stdin, self._process.stdout
        assert given is not None and said is not None
        given.write("go\n")
        given.flush()
        for line in said:
            if line.startswith("took "):
                return float(line.split()[1])
        raise ValueError(f"{WORKER.name} ended early in {PYTHON}: {INSTALL}")
