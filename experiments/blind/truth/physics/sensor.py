"""Effects between the true and the measured state. They change what is recorded and fed back, not the physics."""

import numpy as np

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import History, Stages
from experiments.blind.vocabulary import Effect


def encoder_offset(effect: Effect, stages: Stages[Plant]) -> None:
    """measured q = q + offset"""
    offset = effect.number("offset")

    def edit(plant: Plant, history: History, qpos: np.ndarray, qvel: np.ndarray) -> None:
        qpos[plant.nominal.joint(effect.at).qposadr[0]] += offset

    stages.sensor.append(edit)


def sensor_delay(effect: Effect, stages: Stages[Plant]) -> None:
    """measured q(t - T), and the measured velocity with it; before the beginning the first state holds"""
    delay = effect.number("delay")

    def edit(plant: Plant, history: History, qpos: np.ndarray, qvel: np.ndarray) -> None:
        then = max(history.now - round(delay / plant.dt), 0)
        joint = plant.nominal.joint(effect.at)
        column, dof = joint.qposadr[0], joint.dofadr[0]
        qpos[column] += history.qpos[then, column] - history.qpos[history.now, column]
        qvel[dof] += history.qvel[then, dof] - history.qvel[history.now, dof]

    stages.sensor.append(edit)
