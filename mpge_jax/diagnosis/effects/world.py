"""Gravity, outside forces and contacts."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, default_places, vector_params
from mpge_jax.diagnosis.effects.native import SpecFields
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.machine.model import moving_bodies


def perpendicular(vector: np.ndarray) -> np.ndarray:
    """Two unit vectors [2, 3] perpendicular to a vector, along the world's axes where that is possible."""
    unit = vector / np.linalg.norm(vector)
    axis = np.eye(3)[int(np.argmin(np.abs(unit)))]
    first = axis - unit * (axis @ unit)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])


def rotate(xp: Any, vector: Array, by: Array) -> Array:
    """Rotate a vector [3] by rotation vectors [..., 3] (Rodrigues)."""
    angle2 = (by * by).sum(-1)[..., None] + 1e-24
    angle = xp.sqrt(angle2)
    cross = xp.cross(by, xp.broadcast_to(vector, by.shape))
    dot = (by * vector).sum(-1)[..., None]
    c = xp.cos(angle)
    return vector * c + cross * (xp.sin(angle) / angle) + by * (dot * (1 - c) / angle2)


@register
class GravityTilt(Effect):
    """Fitted as the two components of the rotation vector perpendicular to gravity."""

    id, kinds = "gravity_tilt", ("world",)
    equation = "gravity rotated by an angle about an axis"
    says = "Gravity is tilted by {angle} against the model: the base is not level."
    tries = (0.0,)
    fields = ("opt.gravity",)
    confused_with = ("com_offset", "actuator_bias")
    remedy = "turn the base, or hold still in many poses"

    def places(self, ctx: Context) -> list[Place]:
        # the engine's compensation of gravity would follow the tilt
        seen = np.linalg.norm(ctx.model.opt.gravity) > 0 and not ctx.model.body_gravcomp.any()
        return super().places(ctx) if seen else []

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return tuple(Param(f"tilt_{i}", "rad", -1.5, 1.5, 0.02, prior=0.5) for i in (1, 2))

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1]

    def vector(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1]

    def _vector(self, ctx: Context, theta: Array) -> Array:
        return theta @ perpendicular(np.array(ctx.model.opt.gravity))

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        gravity = np.array(ctx.model.opt.gravity)
        turned = rotate(f.xp, gravity, self._vector(ctx, theta))
        f.add("opt.gravity", (slice(None),), turned - gravity)

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        vector = self._vector(ctx, theta)
        angle = np.linalg.norm(vector, axis=-1)
        return {"angle": angle, "axis": vector / np.maximum(angle, 1e-12)[..., None]}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        vector = float(values["angle"]) * np.asarray(values["axis"], dtype=float)
        return perpendicular(np.array(ctx.model.opt.gravity)) @ vector

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {"angle": "rad", "axis": "1"}


@register
class ExternalForce(Effect):
    """On a body: at its centre of mass. On the world: shared by all bodies in proportion to their masses."""

    id, kinds, tier, runtime, order = "external_force", ("body", "world"), 2, True, 1
    equation = "constant force in the world's frame"
    says = "A constant outside force of {force} acts on {at}."
    tries = (0.0,)
    fields = ("opt.gravity",)
    confused_with = ("actuator_bias", "quadratic_drag")
    remedy = "repeat the motion with the base turned to another heading"

    def places(self, ctx: Context) -> list[Place]:
        bodies = default_places(ctx, "body")
        # as gravity that is turned, which the engine's compensation would follow
        shared = len(bodies) > 1 and not ctx.model.body_gravcomp.any()
        return bodies + (default_places(ctx, "world") if shared else [])

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        f = max(ctx.weight, 1e-3)
        return vector_params("force", "N", 50 * f, 0.05 * f, prior=5 * f)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        if place.kind == "world":
            mass = sum(f.get("body_mass", (b,)) for b in moving_bodies(ctx.model))
            f.add("opt.gravity", (slice(None),), theta / f.xp.asarray(mass)[..., None])

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        return (Forces() if place.kind == "world" else Forces(body=theta)), memory

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        if place.kind == "world":
            self.model(SpecFields(spec), ctx, place, theta)
        return place.kind == "world"


class _Contact(Effect):
    """Sets one number of a geom, or of all geoms and contact pairs."""

    kinds, jagged = ("world", "geom"), True
    ratios: tuple[float, ...] = ()
    """Starting values over the nominal one."""
    pair_columns = 1

    def places(self, ctx: Context) -> list[Place]:
        """The whole world and every geom that touches, but for one that takes part in all contacts: it is the world."""
        if not ctx.contacts:
            return []
        always = set(ctx.contacts[0]).intersection(*ctx.contacts)
        return [p for p in super().places(ctx) if p.kind == "world" or p.index not in always]

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        values = getattr(ctx.model, self.fields[0])[:, 0]
        where = [place.index] if place.kind == "geom" else ctx.touching
        return np.array([abs(float(np.max(values[where]))) if where else 1.0])

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array(self.ratios)[:, None] * self.null(ctx, place)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        of_geoms, of_pairs = self.fields
        if place.kind == "geom":
            f.set(of_geoms, (place.index, 0), theta[..., 0])
            return
        f.set(of_geoms, (slice(None), 0), theta[..., 0, None])
        if ctx.model.npair:
            f.set(of_pairs, (slice(None), slice(0, self.pair_columns)), theta[..., 0, None, None])


@register
class ContactFriction(_Contact):
    id = "contact_friction"
    equation = "sliding friction mu of every geom, or of one"
    fields, pair_columns = ("geom_friction", "pair_friction"), 2
    confused_with = ("viscous_damping",)
    remedy = "push until it slides"
    ratios = (0.85, 0.6, 0.4, 0.25, 0.1, 1.3, 1.8)

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("mu", "1", 0.0, 10.0, 0.05),)

    def sentence(self, place: Place, values: dict[str, Any], less: bool = False) -> str:
        where = "The ground" if place.kind == "world" else place.name
        return f"{where} has a friction coefficient of {values['mu']}, not the model's."


@register
class ContactStiffness(_Contact):
    id, tier = "contact_stiffness", 2
    equation = "time constant of the contact's spring and damper (solref)"
    says = "Contacts yield with a time constant of {time_constant}, not the model's."
    fields = ("geom_solref", "pair_solref")
    confused_with = ("payload_mass",)
    remedy = "drops from several heights"
    ratios = (0.5, 0.75, 1.4, 2.0, 3.0, 5.0)

    def places(self, ctx: Context) -> list[Place]:
        """Where contacts have a time constant: MuJoCo's other format (negative numbers) has a stiffness instead."""
        direct = {g for g in ctx.touching if ctx.model.geom_solref[g, 0] <= 0}
        return [p for p in super().places(ctx) if (p.index not in direct if p.kind == "geom" else not direct)]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dt, nominal = float(ctx.model.opt.timestep), float(self.null(ctx, place)[0])
        return (Param("time_constant", "s", 2 * dt, 1.0, max(0.05 * nominal, 1e-3)),)
