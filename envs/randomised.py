"""Domain randomisation: a task in a machine that is drawn anew for every episode (Tobin et al. 2017, Peng et al. 2018).

The machines are drawn once, a few hundred of them, with all constants that MuJoCo derives; an episode draws one.
"""

import copy
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from envs.c_engine import CEngine
from envs.env import Env
from envs.types import State
from envs.wrappers import Wrapper

_FIELDS = (
    *("body_mass", "body_inertia", "dof_damping", "geom_friction", "actuator_gainprm", "actuator_biasprm"),
    # What MuJoCo derives from them.
    *("body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0", "actuator_acc0"),
)


@dataclass(frozen=True)
class Ranges:
    """Factors on the simulator's own values, drawn uniformly and each by itself.

    Attributes:
      mass: of each body, its inertia included.
      friction: one for the sliding, torsional and rolling friction of all geoms.
      damping: of each joint.
      gain: of each actuator, its bias included.

    Raises:
      ValueError: a range that does not begin above 0, or ends before it begins.
    """

    mass: tuple[float, float] = (0.7, 1.3)
    friction: tuple[float, float] = (0.5, 1.5)
    damping: tuple[float, float] = (0.5, 1.5)
    gain: tuple[float, float] = (0.7, 1.3)

    def __post_init__(self) -> None:
        for name in ("mass", "friction", "damping", "gain"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise ValueError(f"{name}: a range of factors needs 0 < low <= high, got ({low}, {high})")


def draw(model: mujoco.MjModel, ranges: Ranges, seed: int) -> mujoco.MjModel:
    """A copy of `model` with drawn factors, and the constants that follow."""
    rng, drawn = np.random.default_rng(seed), copy.copy(model)
    masses = rng.uniform(*ranges.mass, model.nbody)
    drawn.body_mass[:] *= masses
    drawn.body_inertia[:] *= masses[:, None]
    drawn.geom_friction[:] *= rng.uniform(*ranges.friction)
    drawn.dof_damping[:] *= rng.uniform(*ranges.damping, model.nv)
    gains = rng.uniform(*ranges.gain, model.nu)[:, None]
    drawn.actuator_gainprm[:] *= gains
    drawn.actuator_biasprm[:] *= gains
    mujoco.mj_setConst(drawn, mujoco.MjData(drawn))
    return drawn


class RandomisedEnv(Wrapper):
    """An environment like any other, on MuJoCo's C engine, in one of `machines` drawn machines, drawn at every reset.

    Args:
      env: the simulator.
      ranges: how far machines differ from it.
      machines: how many are drawn.
      seed: of the draws.
    """

    _env: Env

    def __init__(self, env: Env, ranges: Ranges | None = None, machines: int = 256, seed: int = 0):
        super().__init__(Env(env.task, env.model, CEngine(env.model, fields=_FIELDS), env.variant))
        ranges = Ranges() if ranges is None else ranges
        seeds = np.random.SeedSequence(seed).generate_state(machines)
        models = [draw(env.model, ranges, int(one)) for one in seeds]
        self.machines = {name: np.stack([getattr(m, name) for m in models]) for name in _FIELDS}
        self._count = machines

    def reset(self, key: jax.Array) -> State:
        """The first state of an episode; `info["machine"]` is the machine drawn for it. `key` is consumed."""
        key_machine, key_reset = jax.random.split(key)
        state = self._env.reset(key_reset)
        machine = jax.random.randint(key_machine, (), 0, self._count)
        kind = state.obs.dtype
        given = {name: jnp.asarray(values, kind)[machine] for name, values in self.machines.items()}
        info = {**state.info, "machine": machine}
        return state.replace(data=state.data.replace(given=given), info=info)

    def step(self, state: State, action: jax.Array) -> State:
        """One step of the machine under `action [A]`."""
        return self._env.step(state, action)
