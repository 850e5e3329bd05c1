"""What a drive makes of the command that reaches it (MuJoCo's scalar force, before the gear)."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.machine.model import has_plain_law, is_joint_transmission

_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_NO_BIAS = int(mujoco.mjtBias.mjBIAS_NONE)
_FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
SOFT = ":soft"
NEAR = 1.5
"""How near to its limit, in its largest forces, a drive may reach it."""


def replaceable(ctx: Context, place: Place) -> bool:
    """Whether a drive can be made to give another force (`in_place`): it acts on a joint, or its force follows from its
    command. What others lose can only be taken from their command, and the last step's force would be what was left."""
    return is_joint_transmission(ctx.model, place.index) or has_plain_law(ctx.model, place.index)


def in_place(ctx: Context, place: Place, s: Step, force: Array) -> Forces:
    """A force [...] of a drive in place of its own."""
    own = s.added_to(is_joint_transmission(ctx.model, place.index))
    return Forces(actuator=force - own[..., place.index])


class OfActuator(Effect):
    """What all effects of an actuator share."""

    kinds = ("actuator",)
    side = "actuator"
    within = True
    """Whether it acts on the force that the drive's limits have let through."""


class OfCommand(OfActuator):
    """Changes the commands of a drive that forgets them: an integrator holds those from before the recording too."""

    commands = True

    def places(self, ctx: Context) -> list[Place]:
        integrates = ctx.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR
        return [p for p in super().places(ctx) if not integrates[p.index]]


class _Linear(OfActuator):
    """Changes the gain and bias of a drive, which must be the fixed and affine ones: no muscle, no motor model."""

    fields: tuple[str, ...] = ("actuator_biasprm", "actuator_biastype")

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        plain = (m.actuator_gaintype == _FIXED) & np.isin(m.actuator_biastype, (_NO_BIAS, _AFFINE))
        return [p for p in super().places(ctx) if plain[p.index]]


def _size(ctx: Context, place: Place) -> float:
    """Typical force of the drive."""
    return max(float(ctx.drive[place.index]), 1e-9)


def _unit(ctx: Context, place: Place) -> str:
    """Unit of the scalar force: a plain motor's is its command, which is the joint's force only without a gear."""
    a = place.index
    m = ctx.model
    plain = m.actuator_biastype[a] == _NO_BIAS and m.actuator_gainprm[a, 0] == 1.0
    if plain and abs(m.actuator_gear[a, 0]) != 1.0:
        return "command"
    return "N" if _pulls(m, a) else "N m"


def _pulls(m: mujoco.MjModel, a: int) -> bool:
    """Whether what an actuator drives is measured in metres: a slide, or a tendon through points."""
    driven = int(m.actuator_trnid[a, 0])
    if m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
        return bool(m.wrap_type[m.tendon_adr[driven]] != mujoco.mjtWrap.mjWRAP_JOINT)
    return is_joint_transmission(m, a) and bool(m.jnt_type[driven] == mujoco.mjtJoint.mjJNT_SLIDE)


def _limited(m: mujoco.MjModel, a: int) -> bool:
    """Whether the drive itself limits its force; a limit of its joint comes after everything that the drive does."""
    if not m.actuator_forcelimited[a]:
        return False
    joint, gear = int(m.actuator_trnid[a, 0]), float(m.actuator_gear[a, 0])
    if not is_joint_transmission(m, a) or not m.jnt_actfrclimited[joint] or gear == 0.0:
        return True
    return not np.allclose(m.actuator_forcerange[a], np.sort(m.jnt_actfrcrange[joint] / gear))


def reaches_limit(ctx: Context, a: int) -> bool:
    """Whether a drive comes near its limit of force."""
    return _limited(ctx.model, a) and NEAR * ctx.drive[a] >= np.abs(ctx.model.actuator_forcerange[a]).min()


class _BeforeLimits(OfActuator):
    """A second form, which the drive's limits of force follow: they stay as they are."""

    tier, within = 2, False

    def places(self, ctx: Context) -> list[Place]:
        """Drives that come near their limits; for others it is the same as the plain form."""
        return [p for p in super().places(ctx) if reaches_limit(ctx, p.index)]


@register
class ActuatorGain(_Linear):
    id, order, vanishes_at = "actuator_gain", 1, 1.0
    equation = "tau = g u"
    says = "The actuator {at} gives {gain} times the force that the model expects."
    fields = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
    confused_with = ("payload_mass", "torque_saturation")
    remedy = "steps of command at rest and while moving, in several poses"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("gain", "1", -3.0, 5.0, 0.1),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[0.9], [0.3]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        a, gain = place.index, theta[..., 0]
        for name in ("actuator_gainprm", "actuator_biasprm"):
            f.scale(name, (a,), gain[..., None])
        if self.within and _limited(ctx.model, a):
            ends = gain * f.get("actuator_forcerange", (a, 0)), gain * f.get("actuator_forcerange", (a, 1))
            f.set("actuator_forcerange", (a, 0), f.xp.minimum(*ends))
            f.set("actuator_forcerange", (a, 1), f.xp.maximum(*ends))


@register
class ActuatorGainBeforeLimits(_BeforeLimits, ActuatorGain):
    id = "actuator_gain:limited"
    equation = "tau = clip(g u)"
    says = "The actuator {at} gives {gain} times the force that the model expects, up to limits that are the model's."


@register
class DeadActuator(OfActuator):
    id, order = "dead_actuator", 1
    equation = "tau = 0"
    says = "The actuator {at} gives no force at all."
    fields = ("actuator_gainprm", "actuator_biasprm")
    confused_with = ("actuator_gain",)
    remedy = "steps of command at rest"

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        # of a muscle's numbers, its peak force; its other ones must stay what they are
        muscle = ctx.model.actuator_gaintype[place.index] == mujoco.mjtGain.mjGAIN_MUSCLE
        for name in self.fields:
            f.scale(name, (place.index, 2) if muscle else (place.index,), 0.0)


@register
class ActuatorBias(_Linear):
    id, order = "actuator_bias", 3
    equation = "tau = u + c"
    says = "The actuator {at} adds a constant {bias} to what it is told."
    confused_with = ("gravity_tilt", "asymmetric_friction")
    remedy = "rest in several poses, with the command at zero"
    fields = (*_Linear.fields, "actuator_forcerange")

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = _size(ctx, place)
        return (Param("bias", _unit(ctx, place), -50 * d, 50 * d, 0.1 * d),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.set("actuator_biastype", (place.index,), _AFFINE)
        f.add("actuator_biasprm", (place.index, 0), theta[..., 0])
        for end in (0, 1) if self.within and _limited(ctx.model, place.index) else ():
            f.add("actuator_forcerange", (place.index, end), theta[..., 0])


@register
class ActuatorBiasBeforeLimits(_BeforeLimits, ActuatorBias):
    id = "actuator_bias:limited"
    equation = "tau = clip(u + c)"
    says = "The actuator {at} adds a constant {bias} to what it is told, within the limits of its force."


@register
class ActuatorBiasReclipped(OfCommand, ActuatorBias):
    """The bias of a drive that clips once more after it: added to the command inside the command's limits."""

    id, order, tier = "actuator_bias:reclipped", -3, 2
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


@register
class BackEmf(_Linear):
    id, order = "back_emf", 2
    equation = "tau = k (V - ke v)"
    says = "The actuator {at} loses force with speed, as a motor's back-EMF makes it: {coefficient}."
    says_less = "The model has {coefficient} too much back-EMF in the actuator {at}."
    confused_with = ("viscous_damping",)
    remedy = "compare coasting with the drive switched off to powered motion, or measure the motor's current"

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        # a position servo's command is no voltage: its gain on the length marks it
        return [
            p
            for p in super().places(ctx)
            if is_joint_transmission(m, p.index)
            and m.actuator_biasprm[p.index, 1] == 0
            and m.actuator_gainprm[p.index, 0] != 0
        ]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        m, a = ctx.model, place.index
        speed = max(float(ctx.speed[m.jnt_dofadr[m.actuator_trnid[a, 0]]]), 1e-3)
        scale = 0.1 * _size(ctx, place) / abs(float(m.actuator_gainprm[a, 0])) / speed
        unit = "command s/m" if _pulls(m, a) else "command s/rad"
        given = -float(m.actuator_biasprm[a, 2]) / self._by(ctx, place)
        return (Param("coefficient", unit, min(-given, 0.0), 500 * scale, scale),)

    @staticmethod
    def _by(ctx: Context, place: Place) -> float:
        """What a coefficient of one takes from `biasprm[2]`."""
        m, a = ctx.model, place.index
        return float(m.actuator_gainprm[a, 0]) / float(m.actuator_gear[a, 0])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        a = place.index
        f.set("actuator_biastype", (a,), _AFFINE)
        f.add("actuator_biasprm", (a, 2), -self._by(ctx, place) * theta[..., 0])


@register
class TorqueSaturation(OfActuator):
    id, order, closer = "torque_saturation", 5, (SOFT,)
    equation = "clip(tau, +-limit)"
    says = "The actuator {at} gives at most {limit}."
    fields = ("actuator_forcerange", "actuator_forcelimited")
    confused_with = ("actuator_gain",)
    remedy = "large steps of command"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = _size(ctx, place)
        return (Param("limit", _unit(ctx, place), 0.0, 3 * d, 0.1 * d),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        # a motor that seldom saturates does so near its largest force
        return np.array([[1.1], [1.05], [1.02], [0.99], [0.96], [0.8], [0.5], [0.25]]) * _size(ctx, place)

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return []

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        a, low, high, limit = place.index, -1e12, 1e12, theta[..., 0]
        if ctx.model.actuator_forcelimited[a]:
            low, high = (f.get("actuator_forcerange", (a, end)) for end in (0, 1))
        f.set("actuator_forcelimited", (a,), 1)
        # a bias may have moved the drive's own limits past this one
        f.set("actuator_forcerange", (a, 0), f.xp.clip(low, -limit, limit))
        f.set("actuator_forcerange", (a, 1), f.xp.clip(high, -limit, limit))


@register
class ActuatorDeadzone(OfActuator):
    id, order, runtime = "actuator_deadzone", 4, True
    equation = "sign(tau) max(|tau| - width, 0)"
    says = "The actuator {at} ignores forces smaller than {width}."
    confused_with = ("backlash", "coulomb_friction")
    remedy = "commands of small and of large amplitude"

    def places(self, ctx: Context) -> list[Place]:
        return [p for p in super().places(ctx) if replaceable(ctx, p)]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        d = _size(ctx, place)
        return (Param("width", _unit(ctx, place), 0.0, 2 * d, 0.1 * d),)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        a = place.index
        f = (s.f if self.within and _limited(ctx.model, a) else s.f_free)[..., a]
        shrunk = xp.sign(f) * xp.maximum(xp.abs(f) - theta[..., 0], 0.0)
        # limits that a bias has moved past zero do not hold what the dead zone leaves
        least, most = xp.minimum(s.force_low[..., a], 0.0), xp.maximum(s.force_high[..., a], 0.0)
        clipped = xp.minimum(xp.maximum(shrunk, least), most)
        return in_place(ctx, place, s, clipped), memory


@register
class ActuatorDeadzoneBeforeLimits(_BeforeLimits, ActuatorDeadzone):
    id = "actuator_deadzone:limited"
    equation = "clip(sign(tau) max(|tau| - width, 0))"
    says = "The actuator {at} ignores forces smaller than {width}, and still reaches the limits of its force."
