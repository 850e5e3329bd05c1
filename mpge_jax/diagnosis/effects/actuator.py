"""Effects between the command and the force of an actuator (MuJoCo's scalar force, before the gear)."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from scipy.signal import lfilter

from mpge_jax.diagnosis.effects.base import (
    Array,
    Context,
    Effect,
    Fields,
    Forces,
    Param,
    Place,
    Step,
    register,
    spec_actuator,
)
from mpge_jax.diagnosis.model import is_joint_transmission

_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_NO_BIAS = int(mujoco.mjtBias.mjBIAS_NONE)
_FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)


class _Actuator(Effect):
    kinds = ("actuator",)
    side = "actuator"

    def _drive(self, ctx: Context, place: Place) -> float:
        return max(float(ctx.drive[place.index]), 1e-9)

    def _unit(self, ctx: Context, place: Place) -> str:
        a = place.index
        m = ctx.model
        plain = m.actuator_biastype[a] == _NO_BIAS and abs(m.actuator_gear[a, 0]) != 1.0
        if plain:
            return "command"
        joint = int(m.actuator_trnid[a, 0])
        slide = is_joint_transmission(m, a) and m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        return "N" if slide else "N m"


def _simple(ctx: Context, place: Place) -> bool:
    """Whether gain and bias are the fixed and affine ones, without a muscle or motor model."""
    m, a = ctx.model, place.index
    return m.actuator_gaintype[a] == _FIXED and m.actuator_biastype[a] in (_NO_BIAS, _AFFINE)


@register
class ActuatorGain(_Actuator):
    id, order = "actuator_gain", 1
    equation = "tau = g u"
    fields = ("actuator_gainprm", "actuator_biasprm")
    remedy = "steps of command at rest and while moving, in several poses"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("gain", "1", -3.0, 5.0, 0.1),)

    def places(self, ctx: Context) -> list[Place]:
        return [p for p in super().places(ctx) if _simple(ctx, p)]

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[0.9], [0.3]])

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        return np.ones(1)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        for name in self.fields:
            f.scale(name, (place.index,), theta[..., 0, None])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        a.gainprm = np.array(a.gainprm) * theta[0]
        a.biasprm = np.array(a.biasprm) * theta[0]
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} gives {values['gain']} times the force that the model expects."


@register
class DeadActuator(_Actuator):
    id, order = "dead_actuator", 1
    equation = "tau = 0"
    fields = ("actuator_gainprm", "actuator_biasprm", "actuator_gaintype", "actuator_biastype")
    remedy = "steps of command at rest"

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.zeros((1, 0))

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        for name in ("actuator_gainprm", "actuator_biasprm"):
            f.scale(name, (place.index,), 0.0)

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        a.gainprm = np.array(a.gainprm) * 0.0
        a.biasprm = np.array(a.biasprm) * 0.0
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} gives no force at all."


@register
class ActuatorBias(_Actuator):
    id, order = "actuator_bias", 3
    equation = "tau = u + c"
    fields = ("actuator_biasprm", "actuator_biastype")
    remedy = "rest in several poses, with the command at zero"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = self._drive(ctx, place)
        return (Param("bias", self._unit(ctx, place), -50 * d, 50 * d, 0.1 * d),)

    def places(self, ctx: Context) -> list[Place]:
        return [p for p in super().places(ctx) if _simple(ctx, p)]

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.set("actuator_biastype", (place.index,), _AFFINE)
        f.add("actuator_biasprm", (place.index, 0), theta[..., 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        a.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        prm = np.array(a.biasprm)
        prm[0] += theta[0]
        a.biasprm = prm
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} adds a constant {values['bias']} to what it is told."


@register
class ActuatorBiasReclipped(ActuatorBias):
    """The bias of a drive that clips once more after it: added to the command inside the command's limits."""

    id, order, tier, commands = "actuator_bias:reclipped", -3, 2, True
    equation = "tau = clip(u + c)"

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        return [
            p
            for p in super().places(ctx)
            if m.actuator_ctrllimited[p.index] and m.actuator_gainprm[p.index, 0] != 0
        ]

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        """Nothing: the command carries it."""

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        m, a = ctx.model, place.index
        low, high = m.actuator_ctrlrange[a]
        shape = u * 0
        return shape + float(m.actuator_gainprm[a, 0]), shape + float(low), shape + float(high)

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        gain, low, high = memory
        return xp.clip(u, low, high) + theta[..., 0] / gain, memory

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        m, a = ctx.model, place.index
        return np.clip(u, *m.actuator_ctrlrange[a]) + theta[:, :1] / float(m.actuator_gainprm[a, 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        return False


@register
class BackEmf(_Actuator):
    id, order, tier = "back_emf", 2, 1
    equation = "tau = k (V - ke v)"
    fields = ("actuator_biasprm", "actuator_biastype")
    remedy = "compare coasting with the drive switched off to powered motion, or measure the motor's current"

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        # a position servo's command is no voltage: its gain on the length marks it
        return [
            p
            for p in super().places(ctx)
            if _simple(ctx, p)
            and is_joint_transmission(m, p.index)
            and m.actuator_biasprm[p.index, 1] == 0
            and m.actuator_gainprm[p.index, 0] != 0
        ]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        m, a = ctx.model, place.index
        speed = max(float(ctx.speed[m.jnt_dofadr[m.actuator_trnid[a, 0]]]), 1e-3)
        scale = 0.1 * self._drive(ctx, place) / abs(float(m.actuator_gainprm[a, 0])) / speed
        return (Param("coefficient", "command s/rad", 0.0, 500 * scale, scale),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        m, a = ctx.model, place.index
        f.set("actuator_biastype", (a,), _AFFINE)
        k = float(m.actuator_gainprm[a, 0]) / float(m.actuator_gear[a, 0])
        f.add("actuator_biasprm", (a, 2), -k * theta[..., 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        m, i = ctx.model, place.index
        a = spec_actuator(spec, i)
        a.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        prm = np.array(a.biasprm)
        prm[2] -= float(m.actuator_gainprm[i, 0]) / float(m.actuator_gear[i, 0]) * theta[0]
        a.biasprm = prm
        return True


@register
class TorqueSaturation(_Actuator):
    id, order = "torque_saturation", 5
    equation = "clip(tau, +-limit)"
    fields = ("actuator_forcerange", "actuator_forcelimited")
    remedy = "large steps of command"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = self._drive(ctx, place)
        return (Param("limit", self._unit(ctx, place), 0.0, 3 * d, 0.1 * d),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[1.02], [0.96], [0.8], [0.5], [0.25]]) * self._drive(ctx, place)

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return []

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        m, a = ctx.model, place.index
        low, high = m.actuator_forcerange[a] if m.actuator_forcelimited[a] else np.array([-np.inf, np.inf])
        f.set("actuator_forcelimited", (a,), 1)
        limit = theta[..., 0]
        f.set("actuator_forcerange", (a, 0), f.xp.maximum(-limit, max(float(low), -1e12)))
        f.set("actuator_forcerange", (a, 1), f.xp.minimum(limit, min(float(high), 1e12)))

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        low, high = a.forcerange if ctx.model.actuator_forcelimited[place.index] else (-np.inf, np.inf)
        a.forcelimited = 1
        a.forcerange = [max(float(low), -float(theta[0])), min(float(high), float(theta[0]))]
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} gives at most {values['limit']}."


@register
class ActuatorDeadzone(_Actuator):
    id, order, runtime = "actuator_deadzone", 4, True
    equation = "sign(tau) max(|tau| - width, 0)"
    remedy = "commands of small and of large amplitude"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = self._drive(ctx, place)
        return (Param("width", self._unit(ctx, place), 0.0, 2 * d, 0.1 * d),)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        a = place.index
        f = s.f_free[..., a]
        shrunk = xp.sign(f) * xp.maximum(xp.abs(f) - theta[..., 0], 0.0)
        clipped = xp.minimum(xp.maximum(shrunk, s.force_low[..., a]), s.force_high[..., a])
        return Forces(actuator=clipped - s.f[..., a]), memory

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} ignores forces smaller than {values['width']}."


@register
class ActuatorDelay(_Actuator):
    id, order, commands = "actuator_delay", -2, True
    equation = "u(t - T)"
    remedy = "a chirp of commands over a wide band, with a second sensor that shows when the response begins"
    max_delay = 0.25

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("delay", "s", 0.0, self.max_delay, 0.5 * max(ctx.period, 2e-3)),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[1.0], [4.0]]) * max(ctx.period, 2e-3)

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        n = int(np.ceil(self.max_delay / dt)) + 2
        return xp.repeat(u[..., None], n, -1)

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        # memory[..., i] is the command of i steps ago
        memory = xp.concatenate([u[..., None], memory[..., :-1]], -1)
        lag = xp.minimum(theta[..., 0] / dt, memory.shape[-1] - 2.0)
        whole = xp.floor(lag)
        near = xp.take_along_axis(memory, whole.astype(int)[..., None], -1)[..., 0]
        far = xp.take_along_axis(memory, whole.astype(int)[..., None] + 1, -1)[..., 0]
        part = lag - whole
        return (1 - part) * near + part * far, memory

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        lag = (theta[:, 0] / dt)[:, None]
        whole = np.floor(lag).astype(int)
        index = np.arange(u.shape[1])[None] - whole
        near = np.take_along_axis(u, np.maximum(index, 0), 1)
        far = np.take_along_axis(u, np.maximum(index - 1, 0), 1)
        part = lag - whole
        return (1 - part) * near + part * far

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        dt = float(ctx.model.opt.timestep)
        if theta[0] < dt:
            return False
        a.delay = float(theta[0])
        a.nsample = int(np.ceil(theta[0] / dt)) + 1
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} obeys its command {values['delay']} late."


@register
class ActuatorLag(_Actuator):
    id, order, commands = "actuator_lag", -1, True
    equation = "T du_f/dt = u - u_f"
    remedy = "a chirp of commands over a wide band"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("time_constant", "s", 1e-5, 1.0, 0.5 * max(ctx.period, 2e-3)),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[1.0], [5.0]]) * max(ctx.period, 2e-3)

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        return u

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        # exact mean over the step of the first-order response to a held command
        T = theta[..., 0]
        decay = xp.exp(-dt / T)
        mean = u + (memory - u) * (1 - decay) * T / dt
        return mean, u + (memory - u) * decay

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        # the recursion of `command` as a linear filter, once per distinct time constant
        out = np.empty_like(u)
        for T in np.unique(theta[:, 0]):
            rows = theta[:, 0] == T
            decay = np.exp(-dt / T)
            share = (1 - decay) * T / dt
            start = u[rows, :1]
            state, _ = lfilter(
                [0.0, 1 - decay], [1.0, -decay], u[rows] - start, axis=1, zi=np.zeros((rows.sum(), 1))
            )
            out[rows] = u[rows] + (state + start - u[rows]) * share
        return out

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = spec_actuator(spec, place.index)
        if a.dyntype != mujoco.mjtDyn.mjDYN_NONE:
            return False
        a.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        prm = np.array(a.dynprm)
        prm[0] = theta[0]
        a.dynprm = prm
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The actuator {place.name} follows its command with a time constant of {values['time_constant']}."
