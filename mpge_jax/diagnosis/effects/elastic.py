"""Stiffness, cogging, rotor inertia, and drives that join motor and link through a spring or a gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import (
    Array,
    Context,
    Effect,
    Fields,
    Forces,
    Param,
    Place,
    Step,
    joint_unit,
    register,
    spec_joint,
)
from mpge_jax.diagnosis.model import actuators_of_joint


@register
class JointStiffness(Effect):
    """Fitted as -k q + c; c = k q0."""

    id, kinds = "joint_stiffness", ("joint",)
    equation = "-k (q - q0)"
    fields = ("jnt_stiffness", "qpos_spring")
    remedy = "sweep the joint slowly through its whole range"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dof = ctx.dof(place)
        torque, travel = float(ctx.torque[dof]), max(float(ctx.travel[dof]), 1e-3)
        k = torque / travel
        return (
            Param("stiffness", joint_unit(ctx, place, "N m/rad", "N/m"), 1e-4 * k, 100 * k, 0.1 * k),
            Param("reference", joint_unit(ctx, place, "rad", "m"), -50 * torque, 50 * torque, 0.1 * torque),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[self.params(ctx, place)[0].scale, 0.0]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        j, q = place.index, ctx.qadr(place)
        k0, r0 = f.get("jnt_stiffness", (j,)), f.get("qpos_spring", (q,))
        k = k0 + theta[..., 0]
        f.set("jnt_stiffness", (j,), k)
        f.set("qpos_spring", (q,), (k0 * r0 + theta[..., 1]) / k)

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        return {"stiffness": theta[..., 0], "reference": theta[..., 1] / theta[..., 0]}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        return np.array([values["stiffness"], values["stiffness"] * values["reference"]], dtype=float)

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        m, joint = ctx.model, spec_joint(spec, place.index)
        k0, r0 = float(m.jnt_stiffness[place.index]), float(m.qpos_spring[ctx.qadr(place)])
        k = k0 + float(theta[0])
        stiffness = np.array(joint.stiffness, dtype=float).reshape(-1)
        stiffness[0] = k
        joint.stiffness = stiffness if stiffness.size > 1 else k
        reference = (k0 * r0 + float(theta[1])) / k
        joint.springref = (
            float(np.rad2deg(reference)) if spec.compiler.degree and _hinge(joint) else reference
        )
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return (
            f"A spring of {values['stiffness']} that the model lacks pulls the {place.name} towards "
            f"{values['reference']}."
        )


def _hinge(joint: Any) -> bool:
    import mujoco

    return joint.type == mujoco.mjtJoint.mjJNT_HINGE


@register
class CoggingTorque(Effect):
    """Fitted as a sin(n q) + b cos(n q)."""

    id, kinds, tier, runtime = "cogging_torque", ("joint",), 2, True
    equation = "A sin(n q + phi)"
    remedy = "sweep the joint slowly over full turns"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        t = float(ctx.torque[ctx.dof(place)])
        unit = joint_unit(ctx, place, "N m", "N")
        return (
            Param("amplitude", unit, -20 * t, 20 * t, 0.05 * t),
            Param("phase", "rad", -20 * t, 20 * t, 0.05 * t),
            Param("periods", "1", 0.5, 400.0, 0.02 / max(float(ctx.travel[ctx.dof(place)]), 0.05), prior=2.0),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        a, b, _ = self.params(ctx, place)
        return np.array([[a.scale, b.scale, n] for n in self._periods(ctx, place)])

    def _periods(self, ctx: Context, place: Place) -> list[float]:
        """The numbers of periods at which the missing torque is most nearly a sinusoid of the angle."""
        if ctx.samples is None or not len(ctx.samples.q):
            return [4.0, 12.0]
        q, r = ctx.samples.q[:, ctx.qadr(place)], ctx.samples.residual[:, ctx.dof(place)]
        v = ctx.samples.v[:, ctx.dof(place)]
        limit = np.quantile(np.abs(r), 0.95) + 1e-12
        r = np.clip(r, -limit, limit)
        span = max(float(np.ptp(q)), 1e-2)
        grid = np.arange(max(2.0, 3.0 / span), 80.0, min(0.5, 1.0 / span))
        basis = np.stack([np.ones_like(q), q, v, np.sign(v)], 1)
        power = []
        for n in grid:
            x = np.concatenate([basis, np.sin(n * q)[:, None], np.cos(n * q)[:, None]], 1)
            coefficients = np.linalg.lstsq(x, r, rcond=None)[0]
            power.append(-float(((r - x @ coefficients) ** 2).sum()))
        order = np.argsort(power)[::-1]
        picked: list[float] = []
        for i in order:
            if all(abs(grid[i] - p) > 3.0 / span for p in picked):
                picked.append(float(grid[i]))
            if len(picked) == 3:
                break
        return picked

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1]

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        angle = theta[..., 2] * s.q[..., ctx.qadr(place)]
        return Forces(joint=theta[..., 0] * xp.sin(angle) + theta[..., 1] * xp.cos(angle)), memory

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        a, b = theta[..., 0], theta[..., 1]
        return {"amplitude": np.hypot(a, b), "periods": theta[..., 2], "phase": np.arctan2(b, a)}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        a, phase = float(values["amplitude"]), float(values["phase"])
        return np.array([a * np.cos(phase), a * np.sin(phase), float(values["periods"])])


@register
class Armature(Effect):
    id, kinds = "armature", ("joint",)
    equation = "-J a"
    fields, set_const = ("dof_armature",), True
    remedy = "fast chirps in two poses with different link inertia"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dof = ctx.dof(place)
        scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.acceleration[dof]), 1e-3)
        return (Param("inertia", joint_unit(ctx, place, "kg m^2", "kg"), 0.0, 500 * scale, scale),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), theta[..., 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        joint = spec_joint(spec, place.index)
        joint.armature = float(joint.armature) + float(theta[0])
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return (
            f"The drive of the {place.name} has a rotor inertia of {values['inertia']} that the model lacks."
        )


class _Drive(Effect):
    """Motor and link as two bodies: the nominal armature is the motor, the recorded angle the link's.

    The motor's state (angle, speed) is the effect's memory, stepped implicitly; the link feels the coupling
    torque in place of the actuator's.
    """

    kinds, tier, runtime = ("joint",), 3, True
    fields, set_const = ("dof_armature",), True

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        return [
            p
            for p in super().places(ctx)
            if m.dof_armature[ctx.dof(p)] > 0 and actuators_of_joint(m, p.index)
        ]

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), -float(ctx.model.dof_armature[ctx.dof(place)]))

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        """(spring torque, its slope, damping) at a twist of motor against link."""
        raise NotImplementedError

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array) -> Array:
        """Twist that carries a torque."""
        raise NotImplementedError

    def _torque(self, ctx: Context, place: Place, s: Step, twist: Array, slip: Array) -> tuple[Array, Array]:
        total, direct = 0.0, 0.0
        for a in actuators_of_joint(ctx.model, place.index):
            g = float(ctx.model.actuator_gear[a, 0])
            servo = s.f_position[..., a] * g * twist + s.f_velocity[..., a] * g * slip
            total = total + g * (s.f[..., a] + servo)
            direct = direct + g * s.f[..., a]
        return total, direct

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        torque, _ = self._torque(ctx, place, s, 0 * q, 0 * q)
        return q + self.rest(xp, ctx, place, theta, torque), v

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        dof = ctx.dof(place)
        inertia = float(ctx.model.dof_armature[dof])
        q, v = s.q[..., ctx.qadr(place)], s.v[..., dof]
        angle, speed = memory
        sub = 4
        h = s.dt / sub
        impulse = 0.0
        direct = 0.0
        for i in range(sub):
            twist = angle - (q + v * (i * h))
            torque, direct = self._torque(ctx, place, s, twist, speed - v)
            spring, slope, damping = self.coupling(xp, ctx, place, theta, twist)
            passed = spring + damping * (speed - v)
            # linearly implicit in the motor's speed
            accel = (torque - passed - slope * h * (speed - v)) / (inertia + h * damping + h * h * slope)
            speed_next = speed + h * accel
            transmitted = torque - inertia * accel
            angle = angle + h * speed_next
            speed = speed_next
            impulse = impulse + transmitted / sub
        return Forces(joint=impulse - direct), (angle, speed)


@register
class JointFlexibility(_Drive):
    id = "joint_flexibility"
    equation = "motor and link joined by k twist + d d(twist)/dt"
    remedy = "a chirp past the resonance"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        t = float(ctx.torque[ctx.dof(place)])
        inertia = float(ctx.model.dof_armature[ctx.dof(place)])
        k = max(20 * t, 10.0 * inertia)
        d = 0.2 * np.sqrt(k * inertia)
        return (
            Param(
                "stiffness",
                joint_unit(ctx, place, "N m/rad", "N/m"),
                1e-2 * k,
                1e3 * k,
                0.1 * k,
                prior=20 * k,
            ),
            Param("damping", joint_unit(ctx, place, "N m s/rad", "N s/m"), 0.0, 1e3 * d, d),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        k, d = self.params(ctx, place)
        return np.array([[10 * k.scale * f, d.scale * f**0.5] for f in (0.25, 1.0, 5.0)])

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return []

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        return theta[..., 0] * twist, theta[..., 0], theta[..., 1]

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array) -> Array:
        return torque / theta[..., 0]


@register
class Backlash(_Drive):
    id = "backlash"
    equation = "motor and link joined through a gap of free travel"
    remedy = "slow reversals with and without a load that holds the gap closed"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 1e-2)
        return (Param("gap", joint_unit(ctx, place, "rad", "m"), 0.0, travel, 0.02 * travel),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return self.params(ctx, place)[0].scale * np.array([[0.5], [2.0]])

    def _stiffness(self, ctx: Context, place: Place) -> tuple[float, float]:
        """Contact as stiff as the timestep allows for the motor's inertia, near-critically damped."""
        inertia = float(ctx.model.dof_armature[ctx.dof(place)])
        rate = 0.25 / float(ctx.model.opt.timestep)
        return inertia * rate**2, 1.4 * inertia * rate

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        k, d = self._stiffness(ctx, place)
        half = 0.5 * theta[..., 0]
        past = xp.sign(twist) * xp.maximum(xp.abs(twist) - half, 0.0)
        touching = xp.where(xp.abs(twist) > half, 1.0, 0.0)
        return k * past, k * touching, d * touching

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array) -> Array:
        return xp.sign(torque) * 0.5 * theta[..., 0] + torque / self._stiffness(ctx, place)[0]
