"""Bodies that do not move against each other: a mass added to one of them is the same as one added to another."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import moving_bodies

Array = np.ndarray


def same_body(ctx: Context, a: Term, b: Term) -> bool:
    """Whether two terms add a mass to one rigid body, under whichever name."""
    weld = ctx.model.body_weldid
    return a.name == b.name == "payload_mass" and weld[a.place.index] == weld[b.place.index]


def carried_over(ctx: Context, f: Fitted, term: Term, other: Term) -> Fitted | None:
    """`f` with a payload in place of one of another body: of the same mass at the same point in the usual pose, where
    it does nearly the same. None of other effects."""
    if not term.id == other.id == "payload_mass" or ctx.samples is None or not len(ctx.samples.q):
        return None
    m = ctx.model
    mass, *position = f.hypothesis.split(ctx, f.theta)[term]
    data = mujoco.MjData(m)
    data.qpos[:] = np.median(ctx.samples.q, axis=0)
    mujoco.mj_normalizeQuat(m, data.qpos)
    mujoco.mj_kinematics(m, data)
    turn, shift = _frame_change(data, term.place.index, other.place.index)
    return f.exchanged(ctx, [term], {other: np.array([mass, *turn @ np.array(position) + shift])})


def one_of_each(ctx: Context, fits: list[Fitted]) -> list[Fitted]:
    """`fits`, best first, without those that differ from a better one in the name of a rigid body alone."""
    kept: list[Fitted] = []
    seen: set[tuple[object, ...]] = set()
    for f in fits:
        key = tuple(
            (t.id, "weld", int(ctx.model.body_weldid[t.place.index])) if t.name == "payload_mass" else t
            for t in f.hypothesis.terms
        )
        if key not in seen:
            kept.append(f)
        seen.add(key)
    return kept


def name_nearest(ctx: Context, f: Fitted) -> Fitted:
    """The same fit with every added mass at the body, of those that make up a rigid one, whose centre is nearest."""
    for term in f.hypothesis.terms:
        if term.name == "payload_mass":
            f = _moved(ctx, f, term)
    return f


def _frame_change(data: mujoco.MjData, old: int, new: int) -> tuple[Array, Array]:
    """Rotation [3, 3] and offset [3] from positions in one body's frame to those in another's."""
    to = data.xmat[new].reshape(3, 3).T
    return to @ data.xmat[old].reshape(3, 3), to @ (data.xpos[old] - data.xpos[new])


def _moved(ctx: Context, f: Fitted, term: Term) -> Fitted:
    m = ctx.model
    taken = {t.place.index for t in f.hypothesis.terms if t.name == term.name and t != term}
    weld = m.body_weldid[term.place.index]
    group = [b for b in moving_bodies(m) if m.body_weldid[b] == weld and b not in taken]
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    part = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)]
    old = term.place.index
    point = data.xpos[old] + data.xmat[old].reshape(3, 3) @ f.theta[part][1:4]
    new = min(group, key=lambda b: (round(float(np.linalg.norm(point - data.xipos[b])), 9), b))
    if new == old:
        return f
    turn, shift = _frame_change(data, old, new)
    renamed = Term(term.id, Place("body", ctx.names.bodies[new], new))
    # parameters of the other terms may stand elsewhere afterwards
    h = Hypothesis.of(*(renamed if t == term else t for t in f.hypothesis.terms))
    source = np.concatenate(
        [
            np.arange(f.theta.size)[
                f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term if t == renamed else t)]
            ]
            for t in h.terms
        ]
    )
    jacobian = np.eye(f.theta.size)[source]
    place = h.slices(ctx)[h.terms.index(renamed)]
    rows = slice(place.start + 1, place.start + 4)
    jacobian[rows] = 0.0
    jacobian[rows, part.start + 1 : part.start + 4] = turn
    # a permutation and a rotation: information turns like a covariance
    offset = np.zeros(f.theta.size)
    offset[rows] = shift
    return replace(
        f,
        hypothesis=h,
        theta=jacobian @ f.theta + offset,
        centre=jacobian @ f.centre + offset,
        cov=jacobian @ f.cov @ jacobian.T if f.cov.size else f.cov,
        information=jacobian @ f.information @ jacobian.T if f.information.size else f.information,
    )
