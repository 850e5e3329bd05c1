"""How wrong the nominal model is about a trajectory: open-loop windows from true states, by degree of freedom."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from experiments.blind.truth.simulate import Trajectory

Array = NDArray[np.float64]
WINDOW = 0.5  # s, as the contract reports it


def window_errors(
    model: mujoco.MjModel, run: Trajectory, windows: int = 8, nudge: Array | None = None
) -> Array:
    """Predicted minus true position [rows, nv] over evenly spread windows; commands are held between rows.

    `nudge` [nv]: standard deviations of a fixed random error in every window's start.
    """
    data, errors, rng = mujoco.MjData(model), [], np.random.default_rng(0)
    rows_in = int(np.searchsorted(run.time, run.time[0] + WINDOW))
    for first in np.linspace(0, len(run.time) - rows_in - 1, windows).astype(int):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.time = run.qpos[first], run.qvel[first], run.time[first]
        if nudge is not None:
            mujoco.mj_integratePos(model, data.qpos, nudge * rng.standard_normal(model.nv), 1.0)
        for row in range(first, first + rows_in):
            data.ctrl[:] = run.ctrl[row]
            while data.time + 0.5 * model.opt.timestep < run.time[row + 1]:
                mujoco.mj_step(model, data)
            ahead = data.qpos.copy()
            mujoco.mj_integratePos(model, ahead, data.qvel, run.time[row + 1] - data.time)
            error = np.zeros(model.nv)
            mujoco.mj_differentiatePos(model, error, 1.0, run.qpos[row + 1], ahead)
            errors.append(error)
    return np.nan_to_num(np.array(errors), nan=1e3, posinf=1e3, neginf=-1e3)


def rms(errors: Array) -> Array:
    """Root mean square [nv] over rows; a diverged window counts as 1e3 at most."""
    return np.sqrt((np.clip(errors, -1e3, 1e3) ** 2).mean(0))
