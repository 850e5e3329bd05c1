"""The rows of the comparison: what is run, and what is kept of it as JSON."""

import importlib.metadata
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.benchmark.clock import Row
from experiments.benchmark.peers import environment_steps, error_time, fit, gail, growth, in_turn, sac_updates
from experiments.benchmark.peers.in_turn import OURS
from mpge_jax.learning.sac import SACConfig


def install(peer: str) -> str:
    """The line that adds a peer."""
    return gail.INSTALL if peer == gail.PEER else "pip install -e '.[peers]'"


PACKAGES = {"SBX": "sbx-rl", "Stable-Baselines3": "stable-baselines3", "mujoco.sysid": "mujoco"}
SYSID = "mujoco.sysid"


def steps(rounds: int, copies: int = 512, each: int = 20) -> Row:
    """Environment steps: nothing beyond this project's own packages is needed."""
    work, amounts = environment_steps.calls(copies, each, max(1, each // 10), SACConfig())
    return _kept(in_turn.in_turn(work, rounds), amounts, copies=copies)


def sac(rounds: int, updates: int = 64, config: SACConfig | None = None) -> Row:
    """SAC updates in calls of `updates`."""
    work = sac_updates.calls(updates, config or SACConfig())
    missing = [name for name in sac_updates.PEERS if name not in work]
    return _kept(in_turn.in_turn(work, rounds), dict.fromkeys(work, updates), missing, updates=updates)


def grounding(rounds: int) -> Row:
    """Iterations of grounding: 2,048 simulator steps and every update that follows on them."""
    if not gail.PYTHON.is_file():
        return _kept({}, {}, [gail.PEER])
    with gail.Gail() as peer:
        work = {OURS: gail.ours(), gail.PEER: peer}
        seconds = in_turn.in_turn(work, rounds)
    return _kept(seconds, dict.fromkeys(work, gail.PAPER.batch_size))


def fits(rounds: int, joints: int = 2, runs: int = 3) -> Row:
    """A fit to the same objective, and the whole search once in each round."""
    seconds: dict[str, list[float]] = {name: [] for name in (OURS, SYSID, "sysid to its end", "whole search")}
    with tempfile.TemporaryDirectory() as folder:
        given = fit.problem(Path(folder), joints, runs)
        shape = {
            "joints": joints,
            "runs": runs,
            "windows": given.search.train.count,
            "parameters": len(given.start().theta),
        }
        if not _has_sysid():
            return _kept({}, {}, [SYSID], **shape)
        for number in range(rounds + 1):
            ours, theta = fit.ours(given)
            whole, seen = fit.theirs(given)
            losses = {OURS: given.loss(theta), SYSID: given.loss(seen[-1][1])}
            reached = fit.seconds_to(given, seen, losses[OURS])
            if number:
                for name, taken in ((OURS, ours), (SYSID, reached), ("sysid to its end", whole)):
                    seconds[name].append(taken)
        seconds["whole search"].append(fit.whole_search(given))
    seconds = {name: [x if math.isfinite(x) else whole for x in taken] for name, taken in seconds.items()}
    return _kept(seconds, dict.fromkeys(seconds, 1), loss=losses, **shape)


ROWS: dict[str, Callable[[int], Row]] = {
    "steps": steps,
    "sac": sac,
    "grounding": grounding,
    "error": error_time.measure,
    "growth": growth.measure,
    "fit": fits,
}


def _has_sysid() -> bool:
    return hasattr(fit.toolbox(), "optimize")


def _kept(seconds: Any, amounts: Any, missing: Any = (), **more: Any) -> Row:
    rounded = {name: [float(f"{x:.6g}") for x in taken] for name, taken in seconds.items()}
    found = {
        PACKAGES[name]: importlib.metadata.version(PACKAGES[name]) for name in seconds if name in PACKAGES
    }
    return {"seconds": rounded, "amounts": dict(amounts), "missing": list(missing), "peers": found, **more}
