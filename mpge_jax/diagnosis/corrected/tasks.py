"""Logs of transitions as recordings: what does a policy-learning task lack, according to steps in its target?

target = envs.make("BrokenCheetah")
policies, _ = shipped("HalfCheetah", "MS")
log = target_log.collect(key, target, policies.rollout, 500)
d = diagnose(nominal_spec("HalfCheetah"), recordings_of(log, "HalfCheetah"))
env = d.corrected_env("HalfCheetah")  # the task in the corrected dynamics, for any learner
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs.c_engine import CEngine
from envs.types import Task
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.rollouts.target_log import TargetLog

Array = np.ndarray


def task_of(task: Task | str) -> Task:
    """A registered task by name (of a variant: the task that it changes), or the task itself."""
    return task if isinstance(task, Task) else envs.make(envs.source_of(task), backend="c").task


def nominal_spec(task: Task | str) -> mujoco.MjSpec:
    """The description of a task's own machine, its total mass included, as `diagnose` takes it."""
    task = task_of(task)
    spec = task.spec()
    if task.total_mass is not None:
        spec.compiler.settotalmass = task.total_mass
    return spec


def task_env(corrected: CorrectedModel, task: Task | str, backend: str = "auto") -> envs.Env:
    """A task in a corrected machine: on the plain engine where MuJoCo's elements express every effect, else with the
    effects' equations around it.

    Args:
        corrected: the machine. task: what is asked of it. backend: `c`, `mjx`, or `auto` (`c` on a CPU, else `mjx`).

    Raises:
        ValueError: a backend that cannot simulate it.
    """
    machine = corrected.machine
    native = not any(t.effect.runtime or t.effect.commands or t.effect.senses for t in machine.terms)
    engine = envs.engine_of(machine.model, backend) if native else corrected.jax_engine(backend)
    return envs.Env(task_of(task), machine.model, engine)


def corrected_env(
    spec: mujoco.MjSpec, effects: list[dict[str, Any]], task: Task | str | None, backend: str = "auto"
) -> CorrectedModel | envs.Env:
    """The machine of a nominal description with the entries of `effects.json`, or a task in it (see `task_env`)."""
    corrected = CorrectedModel.build(spec, effects)
    return corrected if task is None else task_env(corrected, task, backend)


def recordings_of(log: TargetLog, task: Task | str) -> list[Recording]:
    """One recording for every episode of every rollout policy, named `policy_K_episode_E`.

    Coordinates that the observation does not hold (a root's horizontal position) are columns of NaN. A recording ends
    where an observed number sits on a bound that the task clips it to, and another begins after it: the true value is
    unknown there.

    Args:
        log: transitions of the target (see `mpge_jax.rollouts.target_log.collect`). task: of the nominal machine.

    Raises:
        InputError: observations that do not determine the task's state, or that belong to another task.
    """
    task = task_of(task)
    if task.to_state is None:
        raise InputError(f"the observations of {task.name} do not determine its state.")
    env = envs.Env(task, model := envs.build_model(task), CEngine(model))
    observation, following, action = (
        np.asarray(x) for x in (log.observation, log.next_observation, log.action)
    )
    sizes = observation.shape[-1], action.shape[-1]
    if sizes != (env.observation_size, env.action_size):
        raise InputError(
            f"the log holds {sizes[0]} observations and {sizes[1]} actions, {task.name} has "
            f"{env.observation_size} and {env.action_size}."
        )
    episode, count = np.asarray(log.episode), np.asarray(log.count)
    pieces: list[tuple[str, Array, Array]] = []
    for k, rows in enumerate(count):
        for e in np.unique(episode[k, :rows]):
            inside = np.flatnonzero(episode[k, :rows] == e)
            seen = np.concatenate([observation[k, inside], following[k, inside[-1:]]])
            pieces.append((f"policy_{k}_episode_{e}", seen, action[k, np.append(inside, inside[-1])]))
    qpos, qvel, seen = _states(env, np.concatenate([p[1] for p in pieces]))
    ends = np.cumsum([len(p[1]) for p in pieces])
    out = []
    for (name, _, command), end in zip(pieces, ends, strict=True):
        rows = slice(end - len(command), end)
        out += _stretches(name, qpos[rows], qvel[rows], command.astype(float), seen[rows], env.dt)
    if not out:
        raise InputError("the log holds no two consecutive observations in which every number is known.")
    return out


def _states(env: envs.Env, observation: Array) -> tuple[Array, Array, Array]:
    """States of observations [T, O]: qpos [T, nq] and qvel [T, nv], NaN in columns that are never observed, and
    whether all others are known [T]."""
    to_state = env.task.to_state
    assert to_state is not None

    @jax.jit
    @jax.vmap
    def told(obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.concatenate(to_state(obs)), env.tells_state(obs)

    states, known = (np.asarray(x) for x in told(jnp.asarray(observation)))
    states = np.where(env.observed, states.astype(float), np.nan)
    return states[:, : env.model.nq], states[:, env.model.nq :], known


def _stretches(
    name: str, qpos: Array, qvel: Array, action: Array, known: Array, dt: float
) -> list[Recording]:
    """The stretches of at least two rows of one episode in which every observed number is known."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    parts = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 2]
    return [
        Recording(
            name if len(parts) == 1 else f"{name}_part_{i}",
            dt * np.arange(a, b),
            qpos[a:b],
            qvel[a:b],
            action[a:b],
        )
        for i, (a, b) in enumerate(parts)
    ]
