"""The environment: a task, perhaps a variant of it, and the engine that moves it."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from envs.c_engine import CEngine
from envs.types import Engine, State, Task, Variant

_RESETS, _BESIDE = 8, 1e-4
"""First states by which it is told what is observed at all, and how far beside a state, as a share of it."""


class Env:
    """Pure `reset(key) -> State` and `step(state, action) -> State` of one environment; batch with `jax.vmap`.

    Attributes:
      name: of the variant, or of the task where there is none.
      task: what is asked.
      variant: how the dynamics differ, or None.
      model: the compiled `MjModel`.
      observation_size, action_size: O and A.
      action_low, action_high: the action box, `[A]`, in the actuators' own units.
      dt: seconds of one step.
      max_steps: time limit of an episode in steps.

    Raises:
      ValueError: an actuator without a control range, a function of the task or variant that returns another shape than
        it should, or a delay of more than one step.
    """

    def __init__(self, task: Task, model: mujoco.MjModel, engine: Engine, variant: Variant | None = None):
        self.name = task.name if variant is None else variant.name
        self.task = task
        self.variant = variant
        self.model = model
        self.engine = engine
        unlimited = [
            model.actuator(i).name or str(i) for i in range(model.nu) if not model.actuator_ctrllimited[i]
        ]
        if unlimited or not model.nu:
            which = f"actuator {unlimited[0]} has none" if unlimited else "it has no actuators"
            raise ValueError(f"{self.name}: the model's actuators need a ctrlrange, the action box; {which}")
        self.action_size = int(model.nu)
        self.action_low, self.action_high = (
            np.array(side, np.float32) for side in model.actuator_ctrlrange.T
        )
        self.dt = float(model.opt.timestep * task.frame_skip)
        self.max_steps = task.max_steps
        self._delay = 0 if variant is None else variant.delay
        if self._delay > task.frame_skip:
            raise ValueError(
                f"{self.name}: a delay of {self._delay} physics steps is longer than one step of {task.name}, "
                f"{task.frame_skip}"
            )
        self.observation_size = self._check_shapes()

    def reset(self, key: jax.Array) -> State:
        """The first state of an episode. `key` is consumed."""
        return self._first_state(*self.task.reset(key))

    def state_from_obs(self, obs: jax.Array) -> State:
        """A state that has the observation `obs [O]`, at step 0 of an episode (free root positions are 0).

        Raises:
          ValueError: where the task's observation does not determine its state, or `obs` has another shape.
        """
        return self._first_state(*self._to_state(obs))

    def tells_state(self, obs: jax.Array) -> jax.Array:
        """Whether `obs [O]` determines the state, `bool []`: not on a bound that the observation is clipped to, where
        it stays the same as the state moves on (Hopper's velocities of 10), so that `state_from_obs` is a guess.

        Raises:
          ValueError: as `state_from_obs`.
        """
        return jnp.all(self._followed(*self._to_state(obs)).all(0) | ~jnp.asarray(self.observed))

    @functools.cached_property
    def observed(self) -> np.ndarray:
        """Which numbers of the state, `(qpos, qvel)`, an observation tells at all, `bool [nq + nv]`: not where a free
        root is."""
        with jax.ensure_compile_time_eval():
            states = jax.vmap(self.task.reset)(jax.random.split(jax.random.key(0), _RESETS))
            return np.asarray(jnp.any(jax.vmap(self._followed)(*states), axis=(0, 1)))

    def _to_state(self, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        if self.task.to_state is None:
            raise ValueError(
                f"{self.task.name} has no to_state: its observation does not determine the state"
            )
        if obs.shape != (self.observation_size,):
            raise ValueError(
                f"{self.name} has observations of shape ({self.observation_size},), got {obs.shape}"
            )
        return self.task.to_state(obs)

    def _followed(self, qpos: jax.Array, qvel: jax.Array) -> jax.Array:
        """Which numbers of a state its observation follows on either side, `bool [2, nq + nv]`."""
        # What an engine computes of a state, or measures otherwise than it is, has no part in this.
        engine, nq = CEngine(self.model), self.model.nq

        def observe(state: jax.Array) -> jax.Array:
            return self.task.observe(engine.init(state[:nq], state[nq:]))

        state = jnp.concatenate([qpos, qvel])
        # On a bound itself the slope is that of the side within.
        beside = _BESIDE * (1.0 + jnp.abs(state))
        sides = jnp.stack([state - beside, state + beside])
        return jnp.abs(jax.vmap(jax.jacfwd(observe))(sides)).max(1) > 0

    def step(self, state: State, action: jax.Array, charged: jax.Array | None = None) -> State:
        """One step under `action [A]`, clipped to the action box. `done` is `terminated` or `truncated`.

        A simulation that diverges ends its episode, with reward 0 and an observation that is not finite.

        The reward charges the action as the variant changes it, before it is clipped (as Gymnasium's tasks do), or
        `charged [A]` where given: a control cost that belongs to what an agent asked for, whatever became of it.

        Raises:
          ValueError: `action` or `charged` has another shape; batch with `jax.vmap`.
        """
        for given in (action, charged):
            if given is not None and given.shape != (self.action_size,):
                raise ValueError(
                    f"{self.name}.step wants an action of shape ({self.action_size},), got {given.shape}; "
                    "batch with jax.vmap"
                )
        low, high = jnp.asarray(self.action_low, action.dtype), jnp.asarray(self.action_high, action.dtype)
        if self.variant is not None and self.variant.action is not None:
            action = self.variant.action(action, low, high)
        info, command = dict(state.info), jnp.clip(action, low, high)
        data = state.data
        if self._delay:
            data = self.engine.step(data, info["command"], self._delay)
            info["command"] = command
        if self._delay < self.task.frame_skip:
            data = self.engine.step(data, command, self.task.frame_skip - self._delay)
        reward, metrics = self.task.reward(state.data, action if charged is None else charged, data, self.dt)
        obs = self.task.observe(data)
        steps = state.info["steps"] + 1
        lost = ~jnp.all(jnp.isfinite(obs))
        reward = jnp.where(lost | ~jnp.isfinite(reward), 0.0, reward).astype(reward.dtype)
        terminated = (self.task.terminated(data) | lost).astype(obs.dtype)
        truncated = (steps >= self.max_steps).astype(obs.dtype)
        info = {
            **info,
            "terminated": terminated,
            "truncated": truncated,
            "steps": steps,
            "next_obs": obs,
        }
        return State(data, obs, reward, jnp.maximum(terminated, truncated), metrics, info)

    def predict(self, obs: jax.Array, action: jax.Array) -> jax.Array:
        """The next observation `[O]` after `action [A]` in a state that has the observation `obs [O]`.

        Raises:
          ValueError: as `state_from_obs` and `step`.
        """
        return self.step(self.state_from_obs(obs), action).info["next_obs"]

    def _first_state(self, qpos: jax.Array, qvel: jax.Array) -> State:
        data = self.engine.init(qpos, qvel)
        obs = self.task.observe(data)
        zero = jnp.zeros((), obs.dtype)
        action = jnp.zeros(self.action_size, obs.dtype)
        _, metrics = self.task.reward(data, action, data, self.dt)
        info = {"terminated": zero, "truncated": zero, "steps": jnp.zeros((), jnp.int32), "next_obs": obs}
        if self._delay:
            info["command"] = action
        return State(data, obs, zero, zero, jax.tree.map(jnp.zeros_like, metrics), info)

    def _check_shapes(self) -> int:
        """The observation's size; what the task's and the variant's functions return is checked on the way."""
        qpos, qvel = jax.eval_shape(self.task.reset, jax.random.key(0))
        self._check_shape("reset's qpos", qpos, (self.model.nq,))
        self._check_shape("reset's qvel", qvel, (self.model.nv,))
        data = jax.eval_shape(self.engine.init, qpos, qvel)
        obs = jax.eval_shape(self.task.observe, data)
        self._check_shape("observe", obs, (obs.size,))
        action = jax.ShapeDtypeStruct((self.action_size,), obs.dtype)
        reward, _ = jax.eval_shape(lambda d, a: self.task.reward(d, a, d, self.dt), data, action)
        self._check_shape("reward", reward, ())
        self._check_shape("terminated", jax.eval_shape(self.task.terminated, data), ())
        if self.variant is not None and self.variant.action is not None:
            changed = jax.eval_shape(self.variant.action, action, action, action)
            self._check_shape("the variant's action", changed, (self.action_size,))
        return int(obs.size)

    def _check_shape(self, what: str, value: Any, shape: tuple[int, ...]) -> None:
        if value.shape != shape:
            raise ValueError(f"{self.name}: {what} has shape {value.shape} where {shape} is wanted")
