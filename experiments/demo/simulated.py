"""The simulated half of the demonstration: conceal, record, diagnose, correct, train, judge."""

from __future__ import annotations

import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import envs
from experiments.demo import arm, policy
from mpge_jax import files
from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.corrected.tasks import task_env

RETURNS, TRAINING = "returns.json", "training"


@dataclass(frozen=True)
class Simulated:
    """What came of it.

    Attributes:
        hidden: what was concealed. found: the contents of `diagnosis.json`.
        returns: by where a policy was trained ("as given", "corrected"): its `target` returns, one an episode, and
            the `curve` of its mean return while it learned, there where it learned.
    """

    hidden: arm.Concealed
    found: dict[str, Any]
    returns: dict[str, dict[str, list[float | None]]]


def simulated_arm(seed: int, out: Path, quiet: bool) -> Simulated:
    """All of it, in `out/recordings`, `out/arm` and `out/training`; what is finished is read from there."""
    hidden = arm.concealed(seed)
    found = _diagnosed(hidden, seed, out, quiet)
    if not (out / RETURNS).exists():
        corrected = task_env(CorrectedModel.from_folder(out / "arm"), arm.TASK)
        places = {"as given": arm.simulator(), "corrected": corrected}
        made = {name: _trained(name, env, hidden, seed, out, quiet) for name, env in places.items()}
        files.write_text(out / RETURNS, json.dumps(made))
        shutil.rmtree(out / TRAINING, ignore_errors=True)
    return Simulated(hidden, found, json.loads((out / RETURNS).read_text()))


def _diagnosed(hidden: arm.Concealed, seed: int, out: Path, quiet: bool) -> dict[str, Any]:
    """The contents of `diagnosis.json`. The model and the recordings are files like anybody's."""
    model, recordings, folder = out / "model.xml", out / "recordings", out / "arm"
    if not (folder / "diagnosis.json").exists():
        files.write_text(model, arm.XML)
        for r in arm.recordings(hidden, seed):
            files.write_npz(recordings / f"{r.name}.npz", {"time": r.time, "qpos": r.qpos, "ctrl": r.ctrl})
        if not quiet:
            print(f"concealed: {hidden.about}; diagnosing six recordings of the arm", file=sys.stderr)
        config = Config(quiet=quiet, jobs=os.cpu_count() or 1)
        progress = out / ".arm.json"
        diagnose(model, recordings, config, progress=progress).write(folder)
        progress.unlink(missing_ok=True)
    return dict(json.loads((folder / "diagnosis.json").read_text()))


def _trained(
    name: str, env: envs.Env, hidden: arm.Concealed, seed: int, out: Path, quiet: bool
) -> dict[str, list[float | None]]:
    actor, curve = policy.train(env, f"policy in the simulator {name}", seed, out / TRAINING / name, quiet)
    returns = policy.returns(arm.target(hidden), actor, seed)
    return {"target": returns.tolist(), "curve": [None if x != x else float(x) for x in curve]}
