"""Torques that depend on the angle of a joint: springs and cogging."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step

LEAST_FREE, FEWEST_ANGLES = 0.05, 50
"""Share of a joint's force that no contact could make instead, from which a sample tells about it, and how many such
samples it takes."""
LOOSEST = 0.999
"""Share of the model's spring, at most, of which there may be too much."""
AT_ONCE = 64
"""Numbers of periods that are tried at once."""
SEEN = 2.0 * np.pi * 2
"""Fewest periods (rad) in the travel: along less than two a sinusoid is like many a force of the angle, and that it
comes again was not seen."""
A_TURN, IN_TRAVEL = 80.0, 2.0 * np.pi * 40
"""Most periods that are tried: a turn, or 40 in the travel where that is more (magnets of a linear motor)."""
FEWEST_PERIODS = 0.5
"""Fewest a turn (rad/m: of a slide)."""
FINEST = 5.0
"""Times as many that a fit may end at."""
SAYS_OF_SLIDE = (
    "A force of {amplitude} that is a sine of {periods} times the position acts at the {at} (cogging)."
)
OUTLYING = 3.0
"""Medians of the missing torque beyond which a sample is wild (impacts)."""
HARDENING = ":hardening"
"""How the identifier of the form of a spring ends that is not linear."""
BENDING = (0.1, -0.1, 0.5)
"""By how much more its stiffness may be, to start from, at a deflection as large as the joint's travel."""
ALONE = (4.0, 12.0)
"""The same where nothing of it is linear: as strong as the plain one at half the travel, or at less."""


def waves(
    periods: np.ndarray, q: np.ndarray, plain: np.ndarray, weight: np.ndarray, r: np.ndarray
) -> list[tuple[float, list[float]]]:
    """What is left of `r` [S] beside columns `plain` [S, k] and a sinusoid of q [S], and (a, b, n) of that, for each
    number of periods."""
    basis = np.linalg.svd(plain, full_matrices=False)[0]
    angle = periods[:, None] * q
    wave = np.stack([np.sin(angle), np.cos(angle)], 1) * weight
    wave, rest = (x - (x @ basis) @ basis.T for x in (wave, r))
    push = wave @ rest
    best = (np.linalg.pinv(wave @ wave.swapaxes(1, 2), hermitian=True) @ push[..., None])[..., 0]
    left = rest @ rest - (push * best).sum(1)
    return [(float(x), [*ab, float(n)]) for x, ab, n in zip(left, best, periods, strict=True)]


@register
class JointStiffness(Effect):
    """Fitted as -k q + c; c = k q0."""

    id, kinds, closer = "joint_stiffness", ("joint",), (HARDENING,)
    equation = "-k (q - q0)"
    says = "A spring of {stiffness} that the model lacks pulls the {at} towards {reference}."
    says_less = "The model's spring at the {at} is too stiff by {stiffness} (towards {reference})."
    fields = ("jnt_stiffness", "qpos_spring")
    confused_with = ("payload_mass", "cogging_torque")
    remedy = "sweep the joint slowly through its whole range"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        torque, travel = _sizes(ctx, place)
        k, given = torque / travel, float(ctx.model.jnt_stiffness[place.index])
        low = -LOOSEST * given if given > 0.0 else 1e-4 * k
        return (
            Param("stiffness", joint_unit(ctx, place, "N m/rad", "N/m"), low, 100 * k, 0.1 * k),
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


@closer_form
class HardeningSpring(Closer):
    """A spring that grows stiffer, or softer, with its deflection."""

    ending = HARDENING
    adds = "; to that come {cubic} times the cube of its deflection."
    runtime = True
    equation = "-k (q - q0) - c (q - q0)^3"

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        torque, travel = _sizes(ctx, place)
        cubic = torque / travel**3
        unit = joint_unit(ctx, place, "N m/rad^3", "N/m^3")
        return (Param("cubic", unit, -3.0 * cubic, 300.0 * cubic, 0.1 * cubic),)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        _, travel = _sizes(ctx, place)
        bent = [[*theta, k * theta[0] / travel**2] for k in BENDING]
        # what the plain one stands for may be the cube alone
        alone = [[*(0.01 * theta), k * theta[0] / travel**2] for k in ALONE]
        return np.array(bent + alone)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        deflection = s.q[..., ctx.qadr(place)] - theta[..., 1] / theta[..., 0]
        return Forces(joint=-theta[..., 2] * deflection**3), memory


def _most_periods(travel: float) -> float:
    """Most periods a turn (rad/m: of a slide) that are looked for in such a travel (rad, m)."""
    return max(A_TURN, IN_TRAVEL / travel)


def _sizes(ctx: Context, place: Place) -> tuple[float, float]:
    """Typical torque and travel of a joint."""
    dof = ctx.dof(place)
    return float(ctx.torque[dof]), max(float(ctx.travel[dof]), 1e-3)


@register
class CoggingTorque(Effect):
    """Fitted as a sin(n q) + b cos(n q)."""

    id, kinds, tier, runtime = "cogging_torque", ("joint",), 2, True
    equation = "A sin(n q + phi)"
    says = "A torque of {amplitude} that comes and goes {periods} times a turn pulls at the {at} (cogging)."
    confused_with = ("joint_stiffness", "stribeck_friction")
    remedy = "sweep the joint slowly over full turns"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        t, travel = (float(x[ctx.dof(place)]) for x in (ctx.torque, ctx.travel))
        unit = joint_unit(ctx, place, "N m", "N")
        return (
            Param("amplitude", unit, -20 * t, 20 * t, 0.05 * t),
            Param("phase", "rad", -20 * t, 20 * t, 0.05 * t),
            Param(
                "periods",
                joint_unit(ctx, place, "1", "rad/m"),
                max(FEWEST_PERIODS, SEEN / travel),
                FINEST * _most_periods(travel),
                0.02 / max(travel, 0.05),
                prior=20.0,
            ),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        """The sinusoids of the angle that the missing torque is most nearly."""
        a, b, n = self.params(ctx, place)
        low, high = (np.array([getattr(p, k) for p in (a, b, n)]) for k in ("low", "high"))
        unknown = np.clip([[a.scale, b.scale, some] for some in (4.0, 12.0)], low, high)
        if ctx.samples is None:
            return unknown
        dof = ctx.dof(place)
        free = ctx.samples.share[:, dof] > LEAST_FREE
        q, v = ctx.samples.q[free, ctx.qadr(place)], ctx.samples.v[free, dof]
        if q.size < FEWEST_ANGLES:
            return unknown
        # a force f leaves share * f, with errors that shrink as the root of the share
        weight = np.sqrt(ctx.samples.share[free, dof])
        r = ctx.samples.residual[free, dof] / weight
        moving = np.abs(v) > 0.1 * float(np.sqrt(np.mean(v**2)))
        limit = OUTLYING * np.median(np.abs(r[moving] if moving.any() else r)) + 1e-12
        r = np.clip(r, -limit, limit)
        span = max(float(np.ptp(q)), 1e-2)
        plain = np.stack([np.ones_like(q), q, v, np.sign(v)], 1) * weight[:, None]
        step = min(1.0, max(0.5, 0.5 * span)) / span
        periods = np.arange(max(2.0, SEEN / span), _most_periods(span), step)
        tried = [
            entry
            for k in range(0, periods.size, AT_ONCE)
            for entry in waves(periods[k : k + AT_ONCE], q, plain, weight, r)
        ]
        picked: list[list[float]] = []
        for _, theta in sorted(tried, key=lambda entry: entry[0]):
            if len(picked) < 3 and all(abs(theta[2] - p[2]) > 3.0 / span for p in picked):
                picked.append(theta)
        return np.clip(picked, low, high) if picked else unknown

    def detours(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Neighbouring numbers of periods, of the same phase in the middle of the motion: the fit is as wavy in them as
        the torque is in the angle."""
        if ctx.samples is None or not len(ctx.samples.q):
            return super().detours(ctx, place, theta)
        q = ctx.samples.q[:, ctx.qadr(place)]
        a, b, n = theta
        change = np.outer((2.0, 4.0, 8.0), (-1.0, 1.0)).ravel() / max(float(np.ptp(q)), 1e-2)
        change = change[n + change > self.params(ctx, place)[2].low]
        # sin(n q + phase) at the middle q stays what it is when the phase turns back by the change times q
        phase = np.arctan2(b, a) - change * float(np.median(q))
        size = np.hypot(a, b)
        return np.stack([size * np.cos(phase), size * np.sin(phase), n + change], 1)

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1]

    def sentence(self, place: Place, values: dict[str, Any], less: bool = False) -> str:
        says = SAYS_OF_SLIDE if "rad/m" in values["periods"] else self.says
        return says.format(at=place.name, **values)

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
