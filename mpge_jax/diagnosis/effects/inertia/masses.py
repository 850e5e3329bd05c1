"""Masses and their places."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, vector_params
from mpge_jax.diagnosis.effects.inertia.rigid_body import add_point_mass
from mpge_jax.diagnosis.effects.step import Array, Fields

EXTENDED = ":extended"
"""How the identifier of the form of a payload ends that is no point."""


class _Inertial(Effect):
    set_const = True

    def places(self, ctx: Context) -> list[Place]:
        """Not bodies whose gravity the engine compensates: it does so at the centre of mass, wherever that moves."""
        return [p for p in super().places(ctx) if p.kind == "world" or ctx.model.body_gravcomp[p.index] == 0]

    def shape(self, ctx: Context, place: Place) -> tuple[np.ndarray, float]:
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
    id, kinds, closer = "payload_mass", ("body",), (EXTENDED,)
    equation = "a point mass at a position in the body's frame"
    says = "{at} carries {mass} more than the model says, at {position} in its own frame."
    fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
    confused_with = ("actuator_gain", "actuator_bias", "joint_stiffness")
    remedy = "hold still in several poses, then move fast in two of them"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        _, size = self.shape(ctx, place)
        scale = 0.1 * max(float(ctx.model.body_mass[place.index]), 0.02 * ctx.mass)
        mass = Param("mass", "kg", 0.0, 500 * scale, scale, prior=300 * scale)
        return (mass, *vector_params("position", "m", 20 * size, 0.05 * size, prior=size))

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        centre, _ = self.shape(ctx, place)
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
        _, size = self.shape(ctx, place)
        return vector_params("offset", "m", 5 * size, 0.03 * size, prior=0.5 * size)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("body_ipos", (place.index,), theta)
