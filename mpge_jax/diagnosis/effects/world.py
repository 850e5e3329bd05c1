"""Gravity, outside forces and contacts."""

from __future__ import annotations

from typing import Any

import mujoco
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
    default_places,
    register,
    spec_geom,
)
from mpge_jax.diagnosis.model import moving_bodies


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
    fields = ("opt.gravity",)
    remedy = "turn the base, or hold still in many poses"

    def places(self, ctx: Context) -> list[Place]:
        return super().places(ctx) if np.linalg.norm(ctx.model.opt.gravity) > 0 else []

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return tuple(Param(f"tilt_{i}", "rad", -1.5, 1.5, 0.02, prior=0.5) for i in (1, 2))

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.zeros((1, 2))

    def naming(self, ctx: Context, place: Place) -> list[int]:
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

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        gravity = np.array(ctx.model.opt.gravity)
        turned = rotate(np, gravity, self._vector(ctx, theta))
        spec.option.gravity = np.array(spec.option.gravity) + turned - gravity
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"Gravity is tilted by {values['angle']} against the model: the base is not level."


@register
class ExternalForce(Effect):
    """On a body: at its centre of mass. On the world: shared by all bodies in proportion to their masses."""

    id, kinds, tier, runtime = "external_force", ("body", "world"), 2, True
    equation = "constant force in the world's frame"
    fields = ("opt.gravity",)
    remedy = "repeat the motion with the base turned to another heading"

    def places(self, ctx: Context) -> list[Place]:
        bodies = default_places(ctx, "body")
        return bodies + (default_places(ctx, "world") if len(bodies) > 1 else [])

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        f = max(ctx.weight, 1e-3)
        return tuple(Param(f"force_{axis}", "N", -50 * f, 50 * f, 0.05 * f, prior=5 * f) for axis in "xyz")

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.zeros((1, 3))

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1, 2]

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        if place.kind == "world":
            mass = float(ctx.model.body_mass[moving_bodies(ctx.model)].sum())
            f.add("opt.gravity", (slice(None),), theta / mass)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        return (Forces() if place.kind == "world" else Forces(body=theta)), memory

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        return {"force": theta}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        return np.array(values["force"], dtype=float)

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {"force": "N"}

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        if place.kind != "world":
            return False
        mass = float(ctx.model.body_mass[moving_bodies(ctx.model)].sum())
        spec.option.gravity = np.array(spec.option.gravity) + theta / mass
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"A constant outside force of {values['force']} acts on {place.name}."


class _Contact(Effect):
    kinds, jagged = ("world", "geom"), True

    def places(self, ctx: Context) -> list[Place]:
        return super().places(ctx) if ctx.contacts else []

    def _geoms(self, place: Place) -> Any:
        return slice(None) if place.kind == "world" else place.index

    def _nominal(self, ctx: Context, place: Place, values: np.ndarray) -> float:
        if place.kind == "geom":
            return float(values[place.index])
        return float(np.max(values[list(ctx.contacts)])) if ctx.contacts else 1.0

    def _export_geoms(self, spec: Any, ctx: Context, place: Place) -> list[Any]:
        if place.kind == "geom":
            return [spec_geom(spec, place.index)]
        return list(spec.geoms)


@register
class ContactFriction(_Contact):
    id = "contact_friction"
    equation = "sliding friction mu of every geom, or of one"
    fields = ("geom_friction", "pair_friction")
    remedy = "push until it slides"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("mu", "1", 0.0, 10.0, 0.05),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        mu = self._nominal(ctx, place, ctx.model.geom_friction[:, 0])
        return mu * np.array([[0.85], [0.6], [0.4], [0.25], [0.1], [1.3], [1.8]])

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([self._nominal(ctx, place, ctx.model.geom_friction[:, 0])])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        mu = theta[..., 0]
        if place.kind == "world":
            f.set("geom_friction", (slice(None), 0), mu[..., None])
            if ctx.model.npair:
                f.set("pair_friction", (slice(None), slice(0, 2)), mu[..., None, None])
        else:
            f.set("geom_friction", (place.index, 0), mu)

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        for geom in self._export_geoms(spec, ctx, place):
            geom.friction = [float(theta[0]), *list(geom.friction)[1:]]
        if place.kind == "world":
            for pair in spec.pairs:
                pair.friction = [float(theta[0])] * 2 + list(pair.friction)[2:]
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        where = "The ground" if place.kind == "world" else place.name
        return f"{where} has a friction coefficient of {values['mu']}, not the model's."


@register
class ContactStiffness(_Contact):
    id, tier = "contact_stiffness", 2
    equation = "time constant of the contact's spring and damper (solref)"
    fields = ("geom_solref", "pair_solref")
    remedy = "drops from several heights"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dt = float(ctx.model.opt.timestep)
        nominal = abs(self._nominal(ctx, place, ctx.model.geom_solref[:, 0]))
        return (Param("time_constant", "s", 2 * dt, 1.0, max(0.05 * nominal, 1e-3)),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        nominal = abs(self._nominal(ctx, place, ctx.model.geom_solref[:, 0]))
        return nominal * np.array([[0.5], [0.75], [1.4], [2.0], [3.0], [5.0]])

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([abs(self._nominal(ctx, place, ctx.model.geom_solref[:, 0]))])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        if place.kind == "world":
            f.set("geom_solref", (slice(None), 0), theta[..., 0, None])
            if ctx.model.npair:
                f.set("pair_solref", (slice(None), 0), theta[..., 0, None])
        else:
            f.set("geom_solref", (place.index, 0), theta[..., 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        for geom in self._export_geoms(spec, ctx, place):
            geom.solref = [float(theta[0]), float(geom.solref[1])]
        if place.kind == "world":
            for pair in spec.pairs:
                pair.solref = [float(theta[0]), float(pair.solref[1])]
        return True

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"Contacts yield with a time constant of {values['time_constant']}, not the model's."


def contact_geoms(model: mujoco.MjModel) -> tuple[int, ...]:
    """Geoms that could touch another by their collision masks."""
    out = []
    for g in range(model.ngeom):
        for h in range(model.ngeom):
            same = model.geom_bodyid[g] == model.geom_bodyid[h]
            mask = (model.geom_contype[g] & model.geom_conaffinity[h]) | (
                model.geom_contype[h] & model.geom_conaffinity[g]
            )
            if not same and mask:
                out.append(g)
                break
    return tuple(out)
