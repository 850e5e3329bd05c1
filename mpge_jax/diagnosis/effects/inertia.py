"""Masses and their places, and what nobody knows of the given ones."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY, Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, default_places, vector_params
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.step import Array, Fields

GIVEN = "given_inertias"
MOST = 3.0
"""Deviations from what the model says, at most."""


def rotation_of(quat: Array, xp: Any) -> Array:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4] (w, x, y, z)."""
    w, x, y, z = (quat[..., i] for i in range(4))
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return xp.stack(rows, -1).reshape(*quat.shape[:-1], 3, 3)


def quaternion_of(r: Array, xp: Any) -> Array:
    """Unit quaternions [..., 4] of rotation matrices: the leading eigenvector of Bar-Itzhack's matrix."""
    t = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    a, b, c = (
        r[..., 2, 1] - r[..., 1, 2],
        r[..., 0, 2] - r[..., 2, 0],
        r[..., 1, 0] - r[..., 0, 1],
    )
    s01, s02, s12 = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    rows = [
        t, a, b, c,
        a, 2 * r[..., 0, 0] - t, s01, s02,
        b, s01, 2 * r[..., 1, 1] - t, s12,
        c, s02, s12, 2 * r[..., 2, 2] - t,
    ]  # fmt: skip
    k = xp.stack(rows, -1).reshape(*r.shape[:-2], 4, 4)
    return xp.linalg.eigh(k)[1][..., -1]


def add_point_mass(
    xp: Any, mass: Array, ipos: Array, inertia: Array, iquat: Array, extra: Array, point: Array
) -> tuple[Array, Array, Array, Array]:
    """Rigid body [...] plus a point mass: (mass, ipos [..., 3], diagonal inertia [..., 3], iquat [..., 4])."""
    total = mass + extra
    centre = (mass[..., None] * ipos + extra[..., None] * point) / total[..., None]

    def shifted(m: Array, d: Array) -> Array:
        square = (d * d).sum(-1)[..., None, None] * np.eye(3)
        return m[..., None, None] * (square - d[..., :, None] * d[..., None, :])

    r = rotation_of(iquat, xp)
    full = (r * inertia[..., None, :]) @ xp.swapaxes(r, -1, -2)
    full = full + shifted(mass, ipos - centre) + shifted(extra, point - centre)
    values, vectors = xp.linalg.eigh(full)
    flip = xp.where(xp.linalg.det(vectors) < 0, -1.0, 1.0)[..., None, None]
    return total, centre, values, quaternion_of(vectors * flip, xp)


class _Inertial(Effect):
    set_const = True

    def places(self, ctx: Context) -> list[Place]:
        """Not bodies whose gravity the engine compensates: it does so at the centre of mass, wherever that moves."""
        return [p for p in super().places(ctx) if p.kind == "world" or ctx.model.body_gravcomp[p.index] == 0]

    def _shape(self, ctx: Context, place: Place) -> tuple[np.ndarray, float]:
        """Centre of mass in the body's frame and a size (m) of the body."""
        m, b = ctx.model, place.index
        children = [c for c in range(b + 1, m.nbody) if m.body_parentid[c] == b]
        reach = [float(np.linalg.norm(m.body_pos[c])) for c in children]
        reach.append(2 * float(np.linalg.norm(m.body_ipos[b])))
        geoms = range(m.body_geomadr[b], m.body_geomadr[b] + m.body_geomnum[b]) if m.body_geomnum[b] else ()
        reach += [float(m.geom_rbound[g]) for g in geoms]
        return np.array(m.body_ipos[b]), max(*reach, 0.1 * ctx.length, 0.01)


@register
class PayloadMass(_Inertial):
    id, kinds = "payload_mass", ("body",)
    equation = "a point mass at a position in the body's frame"
    says = "{at} carries {mass} more than the model says, at {position} in its own frame."
    fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
    confused_with = ("actuator_gain", "actuator_bias", "joint_stiffness")
    remedy = "hold still in several poses, then move fast in two of them"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        _, size = self._shape(ctx, place)
        scale = 0.1 * max(float(ctx.model.body_mass[place.index]), 0.02 * ctx.mass)
        mass = Param("mass", "kg", 0.0, 500 * scale, scale, prior=300 * scale)
        return (mass, *vector_params("position", "m", 20 * size, 0.05 * size, prior=size))

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        centre, _ = self._shape(ctx, place)
        scale = self.params(ctx, place)[0].scale
        reach = 2 * centre if np.linalg.norm(centre) > 1e-6 else centre
        return np.array([[scale, *centre], [scale, *reach]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        b = (place.index,)
        mass, ipos, inertia, iquat = (f.get(name, b) for name in self.fields)
        new = add_point_mass(f.xp, mass, ipos, inertia, iquat, theta[..., 0], theta[..., 1:4])
        for name, value in zip(self.fields, new, strict=True):
            f.set(name, b, value)


@register
class MassScale(_Inertial):
    id, kinds, vanishes_at = "mass_scale", ("world",), 1.0
    equation = "every mass and inertia times one factor"
    says = "The whole machine has {factor} times the mass that the model says."
    fields = ("body_mass", "body_inertia", "body_gravcomp")
    confused_with = ("actuator_gain",)
    remedy = "passive motion and motion under known forces"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("factor", "1", 0.05, 20.0, 0.05),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[1.1]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.scale("body_mass", (slice(None),), theta[..., 0, None])
        f.scale("body_inertia", (slice(None),), theta[..., 0, None, None])
        for body in map(int, np.flatnonzero(ctx.model.body_gravcomp)):
            # a compensation of gravity knows the nominal masses only
            f.scale("body_gravcomp", (body,), 1.0 / theta[..., 0])


@register
class ComOffset(_Inertial):
    id, kinds = "com_offset", ("body",)
    equation = "centre of mass moved"
    says = "The centre of mass of {at} lies {offset} away from where the model has it."
    tries = (0.0,)
    fields = ("body_ipos",)
    confused_with = ("encoder_offset", "gravity_tilt")
    remedy = "hold still in poses over the full range"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        _, size = self._shape(ctx, place)
        return vector_params("offset", "m", 5 * size, 0.03 * size, prior=0.5 * size)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("body_ipos", (place.index,), theta)


class GivenInertias(Effect):
    """Every body's mass and inertia are what the model says but for `share` (a standard deviation), no more than three
    of it."""

    kinds, vanishes_at, named = ("world",), 1.0, False
    equation = "every mass and every inertia times a factor of its own, near one"
    fields = ("body_mass", "body_inertia", "body_gravcomp")
    set_const = True

    def __init__(self, share: float) -> None:
        self.id, self.share = f"{GIVEN}:{share:g}", share

    def bodies(self, ctx: Context) -> list[Place]:
        return default_places(ctx, "body")

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        low, high = 1.0 - MOST * self.share, 1.0 + MOST * self.share
        return tuple(
            Param(f"{what} of {body.name}", "1", low, high, self.share, prior=self.share, known=True)
            for body in self.bodies(ctx)
            for what in ("mass", "inertia")
        )

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Factors of the bodies, in the order of `bodies`."""
        return {"mass": theta[..., 0::2], "inertia": theta[..., 1::2]}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        pairs = [np.asarray(values[name], dtype=float) for name in ("mass", "inertia")]
        return np.stack([x.reshape(len(self.bodies(ctx))) for x in pairs], -1).reshape(-1)

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {"mass": "1", "inertia": "1"}

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.ones((1, 2 * len(self.bodies(ctx))))

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return list(range(2 * len(self.bodies(ctx))))

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        for k, body in enumerate(self.bodies(ctx)):
            mass, inertia = theta[..., 2 * k], theta[..., 2 * k + 1]
            f.scale("body_mass", (body.index,), mass)
            f.scale("body_inertia", (body.index,), inertia[..., None])
            if ctx.model.body_gravcomp[body.index]:
                # a compensation of gravity knows the nominal masses only
                f.scale("body_gravcomp", (body.index,), 1.0 / mass)


def given_inertias(share: float) -> Term:
    """The term of them all."""
    return Term(f"{GIVEN}:{share:g}", Place("world", "world", 0))


@lru_cache
def _of_share(form: str) -> GivenInertias:
    return GivenInertias(float(form.partition(":")[2]))


REGISTRY.families[GIVEN] = _of_share
