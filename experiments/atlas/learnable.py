"""How much of what a diagnosis leaves could be learnt at all.

python -m experiments.atlas.learnable --recordings DIR

Two learners that take any shape (gradient-boosted and extremely randomised trees of scikit-learn) are given what was
recorded at all joints, how far and how long each has moved since it turned, the commands of some rows and the time, and
learn the missing force of the training recordings. What they leave of the test recordings' says what no function of
these inputs, fitted to these recordings, is likely to better. Writes docs/results/atlas/learnable.json;
`python -m experiments.atlas --machine` then shows it.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro

from experiments.atlas import page, record
from experiments.atlas.machines import MACHINES, check_known
from experiments.ending import exit_status
from experiments.storage import commit
from mpge_jax import files
from mpge_jax.diagnosis import Diagnosis
from mpge_jax.diagnosis.estimation.missing_force import missing
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.recordings.three_parts import Part

Array = np.ndarray
LENGTHS = (0.03, 0.06, 0.12)
"""Lengths (s) of windows, from each of which one force is told: the first that tells it finely enough, or the last."""
FINE = 0.2
"""Uncertainty of a force, over the spread of the forces, that is fine enough."""
ODD = 5.0
"""Times the usual uncertainty from which on a window tells nothing."""
MOST = {"train": 1500, "choice": 700, "test": 700}
ROWS_BEFORE = (0, 1, 5)
"""Rows back from which commands are given."""


@dataclass(frozen=True)
class Args:
    """Lets strong learners look for structure in what the diagnoses of the public machines leave."""

    recordings: Annotated[
        Path | None,
        tyro.conf.arg(
            help="folder of the machines' recordings", help_behavior_hint=f"(default: ${record.FOLDER})"
        ),
    ] = field(default_factory=record.folder_given)
    machine: Annotated[tuple[str, ...], tyro.conf.arg(help=f"which: {', '.join(MACHINES)}")] = tuple(MACHINES)
    jobs: Annotated[int, tyro.conf.arg(help="threads of a diagnosis")] = 1
    docs: Annotated[Path, tyro.conf.arg(help="the folder of the documentation")] = Path("docs")

    def __post_init__(self) -> None:
        check_known(self.machine)
        if self.recordings is None or not self.recordings.is_dir():
            raise ValueError("--recordings is no folder; give the one with the machines' recordings")


@dataclass(frozen=True)
class Missing:
    """Missing forces and what goes with them.

    Attributes:
      inputs: [N, D]. force: [N, F]; NaN where not known. unsure: [N, F] standard errors of the forces.
      own: which of the inputs belong to the joint where a force acts, F of them.
    """

    inputs: Array
    force: Array
    unsure: Array
    own: list[list[int]]


def of_forces(e: ForceErrors) -> Missing:
    """Of measured forces, row by row."""
    b, m = e.balance, e.balance.ctx.model
    rows = [np.column_stack([history(t.time, t.q, t.v), np.nan_to_num(t.a)]) for t in b.tracks]
    force = b.telling - e.corrected
    moving = history_size(m)
    own = []
    for a in range(m.nu):
        dof = int(m.jnt_dofadr[m.actuator_trnid[a, 0]])
        own.append([*of_dof(m, dof), moving + dof, moving + m.nv + a])
    return Missing(np.column_stack([np.concatenate(rows), e.corrected]), force, np.zeros_like(force), own)


def of_motion(d: Diagnosis, part: Part) -> Missing:
    """Of a driven machine's motion: a constant force at every degree of freedom in each of many short windows."""
    p = d.prepared
    sources = {"train": p.train, "choice": p.choice, "test": p.test}[part]
    along = [
        np.column_stack([history(s.recording.time, s.states.qpos, s.states.qvel), *_earlier(s.command)])
        for s in sources
    ]
    for length in LENGTHS:
        w = p.windows(part, length, MOST[part])
        if not w.count:
            continue
        force, unsure = missing(p.sim, d.fit, w, p.noise)
        middle = w.start + 0.5 * w.times.max(1)
        at = [
            along[s][np.searchsorted(sources[s].recording.time[:-1], t)]
            for s, t in zip(w.source, middle, strict=True)
        ]
        commands = list(range(history_size(p.model), along[0].shape[1]))
        own = [[*of_dof(p.model, dof), *commands] for dof in range(p.model.nv)]
        found = Missing(np.array(at), force, unsure, own)
        if np.median(unsure / np.maximum(force.std(0), 1e-12)) < FINE:
            break
    return found


def history(time: Array, q: Array, v: Array) -> Array:
    """Inputs [T, .] that a motion [T, nq], [T, nv] tells: where and how fast everything is, in which direction, for how
    long it has moved so and through which angle, and the time."""
    since, through = np.zeros_like(v), np.zeros_like(v)
    step = np.diff(time, prepend=time[0])
    for t in range(1, len(time)):
        same = v[t] * v[t - 1] > 0.0
        since[t] = np.where(same, since[t - 1] + step[t], 0.0)
        through[t] = np.where(same, through[t - 1] + step[t] * v[t], 0.0)
    return np.column_stack([q, v, np.sign(v), since, through, time - time[0]])


def history_size(m: mujoco.MjModel) -> int:
    """How many inputs `history` gives."""
    return int(m.nq + 4 * m.nv + 1)


def of_dof(m: mujoco.MjModel, dof: int) -> list[int]:
    """Which of the inputs of `history` tell of one degree of freedom; its position only where every one has one."""
    where = [dof] if m.nq == m.nv else []
    return [*where, *(m.nq + k * m.nv + dof for k in range(4)), m.nq + 4 * m.nv]


def _earlier(command: Array) -> Iterator[Array]:
    for rows in ROWS_BEFORE:
        yield command[np.maximum(np.arange(len(command)) - rows, 0)]


def learners() -> tuple[Any, Any]:
    """The two, neither of them fitted."""
    # of the optional group `peers`
    from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor

    boosted = HistGradientBoostingRegressor(
        max_iter=150, learning_rate=0.05, min_samples_leaf=20, l2_regularization=1.0, random_state=0
    )
    return boosted, ExtraTreesRegressor(200, min_samples_leaf=8, random_state=0)


def left(known: list[Missing], test: Missing) -> list[float | None]:
    """Share of the rms missing force of the test recordings that the best learner leaves, by force; None where it is
    not known. Both are given the joint's own inputs and all of them; which of the four is best is told by the test
    recordings themselves, which flatters them.

    Args:
      known: to learn from.
    """
    inputs, force, unsure = (
        np.concatenate([getattr(m, name) for m in known]) for name in ("inputs", "force", "unsure")
    )
    out: list[float | None] = []
    for k in range(force.shape[1]):
        seen, judged = _certain(force[:, k], unsure[:, k]), _certain(test.force[:, k], test.unsure[:, k])
        if not seen.any() or not judged.any():
            out.append(None)
            continue
        usual = float(np.median(unsure[seen, k]))
        weight = np.ones(seen.sum()) if usual == 0.0 else 1.0 / (unsure[seen, k] ** 2 + usual**2)
        shares = []
        for which, model in product((test.own[k], list(range(inputs.shape[1]))), learners()):
            model.fit(inputs[seen][:, which], force[seen, k], sample_weight=weight / weight.mean())
            wrong = test.force[judged, k] - model.predict(test.inputs[judged][:, which])
            shares.append(float(np.sqrt((wrong**2).mean() / (test.force[judged, k] ** 2).mean())))
        out.append(round(min(shares), 3))
    return out


def _certain(force: Array, unsure: Array) -> Array:
    known = np.isfinite(force)
    return known & (unsure <= ODD * np.median(unsure[known])) if known.any() else known


def learnt(d: Diagnosis) -> dict[str, Any]:
    """What the learners leave of a diagnosis: shares by actuator (given motion) or degree of freedom."""
    p = d.prepared
    if isinstance(d.held, ForceErrors):
        assert isinstance(d.train, ForceErrors)
        names = list(p.names.actuators)
        known, test = [of_forces(d.train)], of_forces(d.held)
    else:
        names = [f"{p.names.joint_of_dof(p.model, dof)} {dof}" for dof in range(p.model.nv)]
        known, test = [of_motion(d, "train"), of_motion(d, "choice")], of_motion(d, "test")
    shares = dict(zip(names, left(known, test), strict=True))
    return {
        "verdict": d.verdict,
        "rows": [sum(len(m.force) for m in known), len(test.force)],
        "left": shares,
    }


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        args = tyro.cli(Args, prog="python -m experiments.atlas.learnable", description=Args.__doc__)
        path = record.kept(args.docs, page.LEARNT)
        kept = json.loads(path.read_text()) if path.is_file() else {}
        for key in args.machine:
            assert args.recordings is not None
            d = record.diagnosed(MACHINES[key], args.recordings, args.jobs)
            kept[key] = learnt(d) | {"commit": commit()}
            print(key, kept[key], flush=True)
            ordered = {name: kept[name] for name in MACHINES if name in kept}
            files.write_text(path, json.dumps(ordered, indent=1) + "\n")
        return 0

    return exit_status("atlas.learnable", work)


if __name__ == "__main__":
    sys.exit(main())
