"""Environments as `gymnasium.vector.VectorEnv`: n simulations of one environment, stepped in one call."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from envs.bridges.gymnasium import begin, key_of, spaces
from envs.select import select
from envs.types import State
from envs.wrappers import Environment

Stepped = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class GymnasiumVectorBridge(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`n` copies of an environment with the interface of Gymnasium's vector environments, and what those do.

    `terminations` and `truncations` are `[n]`, as are the parts of the reward in `info`, each with a mask `_name` of
    the copies that it is of. A copy whose episode has ended starts the next as `metadata["autoreset_mode"]` says: in
    the step after (whose action it ignores), in the same step (what was before is in `info["final_obs"]` and
    `info["final_info"]`), or when `reset(options={"reset_mask": mask [n]})` asks for it.

    Raises:
      ValueError: `n` below 1, or an autoreset mode that Gymnasium does not have.
    """

    def __init__(self, env: Environment, n: int, autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP):
        if n < 1:
            raise ValueError(f"a vector environment needs at least 1 copy, got {n}")
        self.num_envs = n
        self._mode = AutoresetMode(autoreset)
        self.metadata = {"render_modes": [], "autoreset_mode": self._mode}
        self.single_observation_space, self.single_action_space = spaces(env)
        self.observation_space, self.action_space = (
            batch_space(space, n) for space in (self.single_observation_space, self.single_action_space)
        )

        def anew(keys: jax.Array, state: State, mask: jax.Array) -> tuple[jax.Array, State]:
            """Episodes that begin where `mask [n]` is true; `state` elsewhere."""
            later, first = jax.vmap(lambda key: begin(env, key))(keys)
            return jnp.where(mask, later, keys), select(mask, first, state)

        def advance(
            keys: jax.Array, state: State, action: jax.Array, ended: jax.Array
        ) -> tuple[jax.Array, State, State]:
            """Keys, what the step led to, and where the next one starts."""
            after = jax.vmap(env.step)(state, action)
            if self._mode == AutoresetMode.NEXT_STEP:
                keys, after = anew(keys, after, ended)
                return keys, after, after
            if self._mode == AutoresetMode.SAME_STEP:
                keys, start = anew(keys, after, after.done > 0)
                return keys, after, start
            return keys, after, after

        self._first = jax.jit(jax.vmap(lambda key: begin(env, key)))
        self._anew, self._advance = jax.jit(anew), jax.jit(advance)
        self._keys: jax.Array | None = None
        self._state: State | None = None
        self._ended = np.zeros(n, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """First observations `[n, O]`, and an empty info.

        Args:
          seed: one for each copy, None where a copy goes on from what it had; or the first copy's, those of the others
            following one by one.
          options: `reset_mask [n]`, the copies that begin a new episode (all where there is none).

        Raises:
          ValueError: another number of seeds, or a mask of another shape or type, or without any copy.
        """
        mask = (options or {}).get("reset_mask")
        if mask is not None and (np.shape(mask) != (self.num_envs,) or np.asarray(mask).dtype != bool):
            raise ValueError(f"reset_mask must be a bool array of shape ({self.num_envs},), got {mask!r}")
        if mask is not None and not np.any(mask):
            raise ValueError("reset_mask holds no True: there is nothing to reset")
        if mask is not None and self._state is None:
            raise gymnasium.error.ResetNeeded("the first reset() is of all copies, without a reset_mask")
        chosen = np.ones(self.num_envs, bool) if mask is None else np.array(mask)
        keys = self._seeded(seed, chosen)
        if mask is None:
            self._keys, self._state = self._first(keys)
        else:
            self._keys, self._state = self._anew(keys, self._state, chosen)
        self._ended = self._ended & ~chosen
        return np.array(self._state.obs), {}

    def step(self, actions: np.ndarray) -> Stepped:
        """Observations `[n, O]`, rewards, terminations, truncations and infos after `actions [n, A]`.

        Raises:
          ResetNeeded: there are no episodes yet, or the mode is DISABLED and one has ended and was not reset.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before the first step()")
        if self._mode == AutoresetMode.DISABLED and self._ended.any():
            raise gymnasium.error.ResetNeeded(
                f"the episodes of copies {np.flatnonzero(self._ended).tolist()} have ended: reset them by "
                'reset(options={"reset_mask": mask})'
            )
        asked = jnp.asarray(actions, self._state.obs.dtype)
        begun = self._ended if self._mode == AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        self._keys, after, self._state = self._advance(self._keys, self._state, asked, begun)
        obs, reached, reward, info, metrics = jax.device_get(
            (self._state.obs, after.obs, after.reward, after.info, after.metrics)
        )
        terminated, truncated = info["terminated"] > 0, info["truncated"] > 0
        self._ended = terminated | truncated
        infos: dict[str, Any] = {}
        if self._mode == AutoresetMode.SAME_STEP:
            begun = self._ended
            if begun.any():
                final = np.full(self.num_envs, None, object)
                for i in np.flatnonzero(begun):
                    final[i] = reached[i].copy()
                infos = {"final_obs": final, "_final_obs": begun.copy()}
                infos |= {"final_info": _masked(metrics, begun), "_final_info": begun.copy()}
        infos |= _masked(metrics, ~begun)
        return np.array(obs), np.array(reward, np.float64), terminated, truncated, infos

    def _seeded(self, seed: int | Sequence[int | None] | None, chosen: np.ndarray) -> jax.Array:
        """Keys of all copies `[n]`, anew where a seed was given to a copy that is `chosen [n]`."""
        first = seed if isinstance(seed, int | np.integer) else None
        super().reset(seed=None if first is None else int(first))
        if first is not None:
            seeds: list[int | None] = [int(first) + i for i in range(self.num_envs)]
        else:
            seeds = [None] * self.num_envs if seed is None else list(seed)  # type: ignore[arg-type]
        if len(seeds) != self.num_envs:
            raise ValueError(f"{self.num_envs} copies want as many seeds, got {len(seeds)}")
        kept = self._keys
        if kept is None:
            kept = jnp.stack([key_of(self.np_random) for _ in seeds])
        pairs = zip(seeds, kept, chosen, strict=True)
        return jnp.stack([key_of(np_random(s)[0]) if s is not None and c else key for s, key, c in pairs])


def _masked(metrics: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Parts of the reward as Gymnasium's vector infos: of the copies in `mask [n]`, 0 elsewhere."""
    if not mask.any():
        return {}
    values = {name: np.where(mask, x, 0).astype(np.float64) for name, x in metrics.items()}
    return values | {f"_{name}": mask.copy() for name in metrics}
