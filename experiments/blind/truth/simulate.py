"""One recording: a plant under a controller, sampled by a clock, measured by sensors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.blind.truth.control import Controller, VelocityEstimate
from experiments.blind.truth.plant import Plant, Unstable
from experiments.blind.truth.sensors import Sensors
from experiments.blind.truth.stages import History

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Rows in time order: `qpos`, `qvel` after sensor effects but before noise; `measured_*` as recorded.

    time [T] s; qpos [T, nq]; qvel [T, nv]; ctrl [T, nu]; force [T, nu] just after the row's time; `extra` [T, nv] the
    generalised force that hidden effects in the joints add there.
    """

    time: Array
    qpos: Array
    qvel: Array
    measured_qpos: Array
    measured_qvel: Array
    ctrl: Array
    force: Array
    extra: Array


def simulate(
    plant: Plant,
    controller: Controller | Array,
    ticks: NDArray[np.int64],
    warmup: int,
    start: tuple[Array, Array],
    sensors: Sensors,
    rng: np.random.Generator,
) -> Trajectory:
    """Run from `start`, sample at sub-steps `ticks` [T], drop the first `warmup` rows.

    A controller given as an array [T, nu] is replayed open loop. Raises Unstable when the state leaves +-1e3.
    """
    plant.reset(*start)
    n, model = len(ticks), plant.nominal
    history = History(np.zeros((ticks[-1] + 1, model.nq)), np.zeros((ticks[-1] + 1, model.nv)))
    estimate = VelocityEstimate(model)
    rows = {
        name: np.zeros((n, width))
        for name, width in (
            ("qpos", model.nq),
            ("qvel", model.nv),
            ("measured_qpos", model.nq),
            ("measured_qvel", model.nv),
            ("ctrl", model.nu),
            ("force", model.nu),
            ("extra", model.nv),
        )
    }
    row, command, read = 0, np.zeros(model.nu), sensors.reader(model, rng)
    for k in range(ticks[-1] + 1):
        history.qpos[k], history.qvel[k], history.now = *plant.state(), k
        tick = k == ticks[row]
        if tick:
            qpos, qvel = history.qpos[k].copy(), history.qvel[k].copy()
            if not (np.abs(qpos) < 1e3).all() or not (np.abs(qvel) < 1e3).all():
                raise Unstable("the state left +-1e3")
            for measure in plant.stages.sensor:
                measure(plant, history, qpos, qvel)
            noisy_q, noisy_v = read(qpos, qvel)
            if isinstance(controller, np.ndarray):
                wish = controller[row]
            else:
                wish = controller.command(row, k * plant.dt, noisy_q, estimate.update(k * plant.dt, noisy_q))
            command = np.clip(wish, *plant.ctrl_range)
            rows["qpos"][row], rows["qvel"][row] = qpos, qvel
            rows["measured_qpos"][row], rows["measured_qvel"][row] = noisy_q, noisy_v
            rows["ctrl"][row] = command
        delayed = command
        for stage in plant.stages.command:
            delayed = stage(plant, delayed)
        plant.substep(delayed)
        if tick:
            rows["force"][row], rows["extra"][row] = plant.force, plant.extra[plant.dof_of]
            row += 1
    time = np.asarray(ticks[warmup:] * plant.dt, float)
    return Trajectory(time, **{name: x[warmup:] for name, x in rows.items()})
