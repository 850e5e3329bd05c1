"""Logs of a real target as transitions (s, a, s') of a task, at the task's own control step.

    log = transitions.read(["run.mcap"], "path/to/my_robot.py:MyRobot", columns="map.yaml")
    grounded, curve = mpge_jax.ground(sim, behaviour(log.train.log()), log.train.log(), config, key)

Shapes: `R` transitions, `O` observation, `A` action size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import envs
from envs.c_engine import CEngine
from envs.types import Task
from mpge_jax.diagnosis.corrected.tasks import nominal_spec, task_of
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names, compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings import reader, states
from mpge_jax.diagnosis.recordings.recording import Recording, shown
from mpge_jax.diagnosis.recordings.three_parts import three_parts
from mpge_jax.recorded.control_steps import control_steps
from mpge_jax.recorded.task_columns import in_order_of
from mpge_jax.rollouts.target_log import TargetLog

Array = np.ndarray


@dataclass(frozen=True)
class Transitions:
    """Transitions in the order of the log.

    Attributes:
        observation, action, following: s [R, O], a [R, A], s' [R, O].
        terminated: [R] whether the task calls s' an end; a real machine goes on all the same.
        episode: [R] number of the uninterrupted stretch of a recording, from 0.
    """

    observation: Array
    action: Array
    following: Array
    terminated: Array
    episode: Array

    @property
    def size(self) -> int:
        """R."""
        return len(self.action)

    def log(self, samples: int | None = None, parts: int = 1) -> TargetLog:
        """The first `samples` transitions (None: all) as a log of `parts` policies, which follow one another.

        Raises:
            ValueError: there are fewer, or fewer than one for each part.
        """
        samples = self.size if samples is None else samples
        if not parts <= samples <= self.size:
            raise ValueError(f"{samples} transitions in {parts} parts are not to be had from {self.size}")
        rows = np.array_split(np.arange(samples), parts)
        index = np.stack([np.pad(r, (0, len(rows[0]) - len(r)), mode="edge") for r in rows])
        observation, action, following, terminated = (
            jnp.asarray(x[index], jnp.float32)
            for x in (self.observation, self.action, self.following, self.terminated)
        )
        count = jnp.asarray([len(r) for r in rows], jnp.int32)
        return TargetLog(observation, action, following, terminated, jnp.asarray(self.episode[index]), count)


@dataclass(frozen=True)
class Recorded:
    """What a real target's log holds: transitions to learn from, others that judge only, and what there is to say."""

    train: Transitions
    held: Transitions
    notes: tuple[str, ...]


def read(
    paths: Sequence[str | Path],
    task: Task | str,
    model: str | Path | None = None,
    columns: Mapping[str, Any] | str | Path | None = None,
) -> Recorded:
    """Reads logs of any format that the diagnosis reads.

    Held out are recordings called `heldout_*`, else a quarter of them, else the last quarter of each of a few.
    Velocities that were not recorded are estimated from the positions of the same recording.

    Args:
        paths: files or folders. task: the simulator's.
        model: MJCF or URDF file of the machine, where the log names joints otherwise than the task's own model or in
            another order. columns: renaming and conversion: the file of a map, or its content.

    Raises:
        InputError: the logs cannot be used; the message says what to do.
    """
    task = task_of(task)
    read_by = compile_variable(load_spec(nominal_spec(task) if model is None else model))
    names = names_of(read_by)
    found = reader.read(list(paths), read_by, names, columns)
    for r in found:
        if r.ctrl is None:
            raise InputError(
                f"{r.name}: there are no commands ('ctrl'), so what was done in it is not known."
            )
    parts = three_parts(found, None, np.random.default_rng(0), chosen=False)
    notes = parts.warnings
    seen = [w for r in found for w in r.warnings]
    cut = [_transitions(part, read_by, names, task) for part in (parts.train, [shown(r) for r in parts.test])]
    return Recorded(cut[0][0], cut[1][0], tuple(dict.fromkeys([*notes, *seen, *cut[0][1], *cut[1][1]])))


def _transitions(
    recordings: list[Recording], read_by: mujoco.MjModel, names: Names, task: Task
) -> tuple[Transitions, list[str]]:
    recordings, notes = _with_velocities(recordings, read_by, names)
    env = envs.Env(task, own := envs.build_model(task), CEngine(own))
    half = np.asarray(env.action_high - env.action_low, float) / 2
    parts, first = [], 0
    for r in in_order_of(own, recordings, read_by, names):
        steps = control_steps(r, r.known("qvel"), env.dt, half)
        notes += steps.notes
        observation, _ = _observed(env, r.name, steps.qpos, steps.qvel)
        following, terminated = _observed(env, r.name, steps.next_qpos, steps.next_qvel)
        parts.append(
            Transitions(
                observation, steps.ctrl, following, terminated, first + steps.stretch.astype(np.int32)
            )
        )
        first += int(steps.stretch.max(initial=-1)) + 1
    fields = ("observation", "action", "following", "terminated", "episode")
    joined = Transitions(*(np.concatenate([getattr(p, f) for p in parts]) for f in fields))
    if not joined.size:
        listed = ", ".join(r.name for r in recordings)
        raise InputError(
            f"{listed}: no two rows are one step of {task.name} apart ({env.dt:.4g} s); record longer."
        )
    clipped = np.clip(joined.action, env.action_low, env.action_high)
    beyond = np.mean(np.abs(clipped - joined.action) > 1e-6 * half)
    if beyond:
        notes.append(
            f"{100 * beyond:.2g} % of the commands leave the action box of {task.name} and count as its bounds."
        )
    return replace(joined, action=clipped), notes


def _with_velocities(
    recordings: list[Recording], model: mujoco.MjModel, names: Names
) -> tuple[list[Recording], list[str]]:
    """The recordings with a velocity wherever there are positions."""
    lacking = [np.isnan(r.known("qvel")).all(0) for r in recordings]
    if not any(x.any() for x in lacking):
        return recordings, []
    _, estimates, _ = states.estimate(recordings, model, names)
    unseen = _unseen(recordings, model)
    out = []
    for r, s in zip(recordings, estimates, strict=True):
        qvel = np.broadcast_to(r.known("qvel"), s.qvel.shape)
        filled = np.where(np.isnan(qvel).all(0) & ~unseen, s.qvel, qvel)
        out.append(replace(r, qvel=filled))
    joints = sorted({names.joint_of_dof(model, int(d)) for d in np.flatnonzero(lacking[0] & ~unseen)})
    if not joints:
        return out, []
    return out, [
        f"velocities of {', '.join(joints)} were not recorded; they are estimated from the positions."
    ]


def _unseen(recordings: list[Recording], model: mujoco.MjModel) -> Array:
    """[nv] degrees of freedom of joints whose positions were never measured."""
    out = np.zeros(model.nv, bool)
    never = np.isnan(recordings[0].qpos).all(0)
    starts = np.append(model.jnt_qposadr, model.nq), np.append(model.jnt_dofadr, model.nv)
    for j in range(model.njnt):
        out[starts[1][j] : starts[1][j + 1]] = never[starts[0][j] : starts[0][j + 1]].any()
    return out


def _observed(env: envs.Env, log: str, qpos: Array, qvel: Array) -> tuple[Array, Array]:
    """Observations [R, O] of states, and whether the task ends there [R].

    Raises:
        InputError: the task observes something that was not recorded.
    """

    def one(q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
        data = env.engine.init(q, v)
        return env.task.observe(data), env.task.terminated(data)

    if not len(qpos):
        return np.zeros((0, env.observation_size)), np.zeros(0, bool)
    kind = jnp.result_type(float)
    observation, ended = jax.jit(jax.vmap(one))(jnp.asarray(qpos, kind), jnp.asarray(qvel, kind))
    if np.isnan(observation).any():
        names = names_of(env.model)
        starts = np.append(env.model.jnt_qposadr, env.model.nq)
        never = np.isnan(qpos).all(0)
        joints = [n for j, n in enumerate(names.joints) if never[starts[j] : starts[j + 1]].any()]
        raise InputError(
            f"{log}: {env.task.name} observes {', '.join(joints)}, whose position the log does not hold; say with "
            "--map where it is, or leave it out of the task's observation."
        )
    return np.asarray(observation), np.asarray(ended)
