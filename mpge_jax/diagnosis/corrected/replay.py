"""What a reported machine predicts of other recordings: errors before and after, computed from what a report left.

python -m mpge_jax.diagnosis.corrected.replay RUNS ANSWERS

writes RUNS/case/judged.json for each RUNS/case/report, of the recordings ANSWERS/case_judge_*.npz.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mpge_jax import files
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel, CStepper

Array = NDArray[np.float64]
WINDOW = 0.5  # s
LEAD = 0.2  # s of earlier commands that delays and lags of a window's start come from
WINDOWS = 8
LOST = 1e3  # the error that a machine counts at most that runs away


def errors_of(report: Path, recordings: list[Path]) -> tuple[float, float]:
    """Errors of the model as given and of the machine that `effects.json` in a report's folder describes.

    Each is the root mean square over windows of half a second, degree of freedom by degree of freedom in units of its
    spread over the recordings, and over those. Windows start from the true states, less what the sensors of the
    reported machine add.

    Args:
        recordings: files with `time`, `qpos`, `qvel` and `ctrl` as the true sensors would read without noise.

    Raises:
        InputError: the folder does not hold a machine.
    """
    corrected = CorrectedModel.from_folder(report)
    nominal = CorrectedModel.build(report / "nominal.xml", [])
    runs = [dict(np.load(path)) for path in recordings]
    spread = np.max([run["qvel"].std(0) for run in runs], 0) * WINDOW + 1e-9
    before, after = (_error(machine.c_stepper(), runs, spread) for machine in (nominal, corrected))
    return before, after


def _error(stepper: CStepper, runs: list[dict[str, Array]], spread: Array) -> float:
    rows = np.concatenate(
        [_missed(stepper, run, first, last) for run in runs for first, last in _windows(run)]
    )
    return float(np.sqrt(np.mean((np.clip(np.nan_to_num(rows, nan=LOST), -LOST, LOST) / spread) ** 2)))


def _windows(run: dict[str, Array]) -> list[tuple[int, int]]:
    time = run["time"]
    firsts = np.linspace(time[0] + LEAD, time[-1] - WINDOW - LEAD, WINDOWS)
    return [(int(np.searchsorted(time, t)), int(np.searchsorted(time, t + WINDOW))) for t in firsts]


def _missed(stepper: CStepper, run: dict[str, Array], first: int, last: int) -> Array:
    """Predicted less recorded positions [rows, nv] of one window."""
    model, time = stepper.model, run["time"]
    qpos, qvel = run["qpos"][first].copy(), run["qvel"][first].copy()
    for column, (offset, delay) in stepper.machine.senses().items():
        qpos[column] = np.interp(time[first] + delay, time, run["qpos"][:, column]) - offset
    for dof, delay in stepper.machine.late_speeds().items():
        qvel[dof] = np.interp(time[first] + delay, time, run["qvel"][:, dof])
    begin = int(np.searchsorted(time, time[first] - LEAD))
    counts = np.diff(np.round((time[begin : first + 1] - time[begin]) / model.opt.timestep).astype(int))
    stepper.reset(qpos, qvel, np.repeat(run["ctrl"][begin:first], counts, axis=0))
    errors = []
    for row in range(first, last):
        until = time[row + 1] - time[first]
        stepper.step(run["ctrl"][row], max(0, round((until - stepper.data.time) / model.opt.timestep)))
        seen, error = stepper.measured(), np.zeros(model.nv)
        mujoco.mj_integratePos(model, seen, stepper.measured_speed(), until - stepper.data.time)
        mujoco.mj_differentiatePos(model, error, 1.0, run["qpos"][row + 1], seen)
        errors.append(error)
    return np.array(errors)


def main(runs: Path, answers: Path) -> None:
    """See above; what stands is kept, and a report without a machine is left out."""
    for table in sorted(runs.glob("*/report/effects.json")):
        case = table.parent.parent
        recordings = sorted(answers.glob(f"{case.name}_judge_*.npz"))
        if recordings and not (case / "judged.json").exists():
            files.write_text(case / "judged.json", json.dumps(errors_of(table.parent, recordings)))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
