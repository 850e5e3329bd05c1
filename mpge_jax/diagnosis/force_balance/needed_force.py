"""Actuator forces that a recorded motion needs in a machine with given effects."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.friction.damping import ExplicitDamping
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.step import Forces, Step
from mpge_jax.diagnosis.force_balance.tracks import Track
from mpge_jax.diagnosis.machine.model import moments
from mpge_jax.diagnosis.simulation.single_step import Machine

Array = np.ndarray
MEASURES = ("actuator_gain", "actuator_bias")
"""Effects of actuators that say how their force is measured: its scale and its zero."""
BY_JOINT = ("dof_frictionloss", "dof_armature", "dof_damping")
"""Fields whose forces are added joint by joint to the inverse dynamics without them."""
NOT_RIGID = {
    *BY_JOINT, "dof_solref", "dof_solimp", "dof_dampingpoly",
    "actuator_gainprm", "actuator_biasprm", "actuator_biastype", "actuator_forcerange",
}  # fmt: skip
"""Fields of effects that leave the inverse dynamics without `BY_JOINT` as they are."""
Key = tuple[Any, ...]
ROUNDS = 3
"""Fixed-point rounds for friction that depends on the force itself."""


def can_ask(term: Term) -> bool:
    """Whether `needed` knows what an effect does to the forces.

    It does not where commands decide, which nobody recorded, in contacts, whose inverse dynamics are noise, and where
    an effect remembers more than the recorded motion. Of two forms that differ only in how they are integrated one is
    enough.
    """
    e = term.effect
    if e.side == "actuator":
        return e.id in MEASURES
    remembers = type(e).memory is not Effect.memory
    return not e.jagged and not isinstance(e, ExplicitDamping) and (not remembers or e.traced)


def needed(machine: Machine, track: Track, known: dict[Key, Rigid] | None = None) -> Array:
    """Actuator forces [T, nu], before the gear, that the motion needs in a machine with its effects.

    Dry friction acts against the motion as surely as its direction is known: its share is the expectation of sgn v
    under the track's uncertainty, which is 0 at rest, where friction holds with any force up to its level.

    Args:
        known: keeps the inverse dynamics of this track for the next call.
    """
    model, ctx = machine.model, machine.ctx
    for term, theta in zip(machine.terms, machine.thetas, strict=True):
        if term.effect.senses:
            track, known = (
                track.sensed(ctx.qadr(term.place), ctx.dof(term.place), *term.effect.sense(theta)),
                None,
            )
    rigid = _rigid(machine, track, {} if known is None else known)
    smooth = rigid.needed + model.dof_armature * track.a
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER:
        smooth = smooth + model.dof_damping * track.v
    force = rigid.by_actuator(model, smooth + model.dof_frictionloss * track.direction)
    for _ in range(ROUNDS if machine.runtime else 0):
        pushed, dry = _runtime(machine, track, rigid, force)
        force = rigid.by_actuator(model, smooth + dry * track.direction - pushed)
    return force


def _rigid(machine: Machine, track: Track, known: dict[Key, Rigid]) -> Rigid:
    """The inverse dynamics, computed anew where an effect changes more than `NOT_RIGID`."""
    bodies = sorted({t.place.index for t, _ in machine.runtime if t.place.kind == "body"})
    changed = [
        (str(t), x.tobytes())
        for t, x in zip(machine.terms, machine.thetas, strict=True)
        if not set(t.effect.fields) <= NOT_RIGID
    ]
    key = (*changed, *bodies)
    if key not in known:
        # most calls differ in nothing else from the model as given, or from the last call
        for old in list(known)[1:]:
            del known[old]
        known[key] = Rigid(machine.model, track, bodies)
    return known[key]


class Rigid:
    """Inverse dynamics of one model without `BY_JOINT` along a track.

    Attributes:
        needed: [T, nv]. bias: [T, nv] `qfrc_bias`. velocity: body -> [T, 3]. jacobian: body -> [T, 3, nv], of centres
        of mass. driven: [nv] on which actuators act. inverse: [T or 1, nu, driven] forces of actuators for theirs.
    """

    def __init__(self, model: mujoco.MjModel, track: Track, bodies: list[int]) -> None:
        rows = len(track.time)
        own = {name: getattr(model, name).copy() for name in BY_JOINT}
        for name in own:
            getattr(model, name)[:] = 0.0
        data = mujoco.MjData(model)
        self.needed, self.bias = np.empty((rows, model.nv)), np.empty((rows, model.nv))
        self.velocity = {b: np.empty((rows, 3)) for b in bodies}
        self.jacobian = {b: np.empty((rows, 3, model.nv)) for b in bodies}
        direct = np.all(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        moment = np.empty((1 if direct else rows, model.nu, model.nv))
        qpos, qvel, qacc, inverse = data.qpos, data.qvel, data.qacc, mujoco.mj_inverse
        for t, (q, v, a) in enumerate(zip(track.q, track.v, track.a, strict=True)):
            qpos[:], qvel[:], qacc[:] = q, v, a
            inverse(model, data)
            self.needed[t], self.bias[t] = data.qfrc_inverse, data.qfrc_bias
            for b in bodies:
                six, jacobian = np.zeros(6), np.zeros((3, model.nv))
                mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, b, six, 0)
                mujoco.mj_jacBodyCom(model, data, jacobian, None, b)
                self.velocity[b][t], self.jacobian[b][t] = six[3:], jacobian
            if t < len(moment):
                mujoco.mj_transmission(model, data)
                moment[t] = moments(model, data)
        for name, values in own.items():
            getattr(model, name)[:] = values
        self.driven = np.abs(moment).max(axis=(0, 1), initial=0.0) > 0
        self.inverse = np.linalg.pinv(np.swapaxes(moment[:, :, self.driven], 1, 2))

    def by_actuator(self, model: mujoco.MjModel, needed: Array) -> Array:
        """Measured forces [T, nu] whose moments make up generalised forces [T, nv], as nearly as the actuators can:
        what an actuator of the model gives is its gain times what was measured, and its bias."""
        driven = needed[:, self.driven]
        alike = len(self.inverse) == 1
        force = driven @ self.inverse[0].T if alike else (self.inverse @ driven[..., None])[..., 0]
        gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 0]
        affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
        return (force - np.where(affine, bias, 0.0)) / np.where(gain == 0.0, np.inf, gain)


def _runtime(machine: Machine, track: Track, rigid: Rigid, force: Array) -> tuple[Array, Array]:
    """Generalised forces [T, nv] of the effects that act at every step, and levels [T, nv] of dry friction."""
    model = machine.model
    wide, none = np.full(model.nu, 1e12), np.zeros_like(force)
    s = Step(
        track.q, track.v, force, force, force, -wide, wide, none, none,
        rigid.velocity.__getitem__, track.step, lambda dof: -rigid.bias[:, dof],
        # a motion that is given is not led astray by a force that is told a step late
        inertia=lambda dof: np.full(len(track.time), np.inf),
    )  # fmt: skip
    pushed = np.zeros_like(track.v)
    dry = np.tile(model.dof_frictionloss, (len(track.time), 1))
    for term, theta in machine.runtime:
        out = _along(machine, term, theta, s)
        if out.joint is not None:
            pushed[:, machine.ctx.dof(term.place)] += out.joint
        if out.dry is not None:
            dry[:, machine.ctx.dof(term.place)] += out.dry
        if out.body is not None:
            moved = np.broadcast_to(out.body, (len(track.time), 3))
            pushed += np.einsum("tc,tcv->tv", moved, rigid.jacobian[term.place.index])
    return pushed, np.maximum(dry, 0.0)


def _along(machine: Machine, term: Term, theta: Array, s: Step) -> Forces:
    """Forces of one effect at all rows at once."""
    if term.effect.traced:
        return Forces(joint=term.effect.along(machine.ctx, term.place, theta, s.q))
    memory = term.effect.memory(np, machine.ctx, term.place, theta, s)
    forces: Forces = term.effect.force(np, machine.ctx, term.place, theta, s, memory)[0]
    return forces
