"""Logs of a cart with a pole, written as people write them."""

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np

import envs
from mpge_jax.diagnosis.corrected.tasks import recordings_of
from tests import small


def of_target_log(folder: Path, **options) -> Path:
    """What small policies did in SkewedPendulum, an npz file for each episode that has two steps."""
    log = small.log(size=2, steps=80, **options)
    for r in recordings_of(log, "InvertedPendulum"):
        if r.time.size > 2:
            np.savez(folder / f"{r.name}.npz", time=r.time, qpos=r.qpos, qvel=r.qvel, ctrl=r.ctrl)
    return folder


def swing(every: int = 1, seconds: float = 2.0, hold: int = 2) -> dict[str, np.ndarray]:
    """The pendulum at physics steps of 0.02 s, every so many a row, under commands held for `hold` of them."""
    model = envs.build_model(small.env("InvertedPendulum").task)
    data = mujoco.MjData(model)
    rng, rows = np.random.default_rng(0), []
    data.qpos[1] = 0.1
    for k in range(round(seconds / model.opt.timestep)):
        if k % hold == 0:
            upright = np.concatenate([data.qpos, data.qvel]) @ [1.0, 30.0, 2.0, 4.0]
            command = np.clip(upright + rng.uniform(-1.0, 1.0, 1), -3.0, 3.0)
        if k % every == 0:
            rows.append((data.time, *data.qpos, *data.qvel, *command))
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return {"time": table[:, 0], "qpos": table[:, 1:3], "qvel": table[:, 3:5], "ctrl": table[:, 5:]}


def moved(observation: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Where the simulator goes."""
    return small.step_from(
        "InvertedPendulum", jnp.asarray(observation, jnp.float32), jnp.asarray(action, jnp.float32)
    )
