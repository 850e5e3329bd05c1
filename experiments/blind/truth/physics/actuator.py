"""Effects in the actuators: on the command (delay, lag) and on MuJoCo's scalar actuator force, before the gear."""

import math
from collections import deque

import mujoco
import numpy as np

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import Stages
from experiments.blind.vocabulary import Effect


def _on_force(effect: Effect, stages: Stages[Plant], law) -> None:
    """Replace the force of one actuator by law(plant, force)."""

    def stage(plant: Plant, force: np.ndarray) -> np.ndarray:
        i = plant.actuator(effect.at)
        force = force.copy()
        force[i] = law(plant, i, float(force[i]))
        return force

    stages.force.append(stage)


def actuator_gain(effect: Effect, stages: Stages[Plant]) -> None:
    """tau = g u"""
    g = effect.number("gain")
    _on_force(effect, stages, lambda plant, i, f: g * f)


def dead_actuator(effect: Effect, stages: Stages[Plant]) -> None:
    """tau = 0"""
    _on_force(effect, stages, lambda plant, i, f: 0.0)


def actuator_bias(effect: Effect, stages: Stages[Plant]) -> None:
    """tau = u + c, after the clip of the command"""
    c = effect.number("bias")
    _on_force(effect, stages, lambda plant, i, f: f + c)


def torque_saturation(effect: Effect, stages: Stages[Plant]) -> None:
    """clip(tau, +-limit)"""
    limit = effect.number("limit")
    _on_force(effect, stages, lambda plant, i, f: min(max(f, -limit), limit))


def actuator_deadzone(effect: Effect, stages: Stages[Plant]) -> None:
    """sign(f) max(|f| - width, 0)"""
    width = effect.number("width")
    _on_force(effect, stages, lambda plant, i, f: math.copysign(max(abs(f) - width, 0.0), f))


def back_emf(effect: Effect, stages: Stages[Plant]) -> None:
    """tau = k (V - ke v): k the nominal gain, v the velocity of the joint that the actuator drives"""
    ke = effect.number("coefficient")

    def law(plant: Plant, i: int, force: float) -> float:
        joint = mujoco.mj_id2name(
            plant.nominal, mujoco.mjtObj.mjOBJ_JOINT, int(plant.nominal.actuator_trnid[i, 0])
        )
        return force - plant.gain[i] * ke * plant.v(plant.stages.drive_joint.get(joint, joint))

    _on_force(effect, stages, law)


def actuator_delay(effect: Effect, stages: Stages[Plant]) -> None:
    """u(t - T): a delay line as long as T; before the first command the first command holds."""
    delay = effect.number("delay")
    line: deque[float] = deque()

    def stage(plant: Plant, command: np.ndarray) -> np.ndarray:
        i, steps = plant.actuator(effect.at), round(delay / plant.dt)
        if not line:
            line.extend([float(command[i])] * steps)
        line.append(float(command[i]))
        command = command.copy()
        command[i] = line.popleft()
        return command

    stages.command.append(stage)
    stages.restart.append(line.clear)


def actuator_lag(effect: Effect, stages: Stages[Plant]) -> None:
    """T du_f/dt = u - u_f, integrated exactly while the command is held"""
    time_constant = effect.number("time_constant")
    state: list[float] = []

    def stage(plant: Plant, command: np.ndarray) -> np.ndarray:
        i = plant.actuator(effect.at)
        u = float(np.clip(command[i], plant.ctrl_range[0][i], plant.ctrl_range[1][i]))
        if not state:
            state.append(u)
        command = command.copy()
        command[i] = state[0]
        state[0] += (1 - math.exp(-plant.dt / time_constant)) * (u - state[0])
        return command

    stages.command.append(stage)
    stages.restart.append(state.clear)
