"""Where the nominal model lacks force: joints, and the actuators, bodies or world at which an effect was found."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.missing_force import active_dofs, excess_by_dof
from mpge_jax.diagnosis.estimation.whitening import whitener
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
from mpge_jax.diagnosis.machine.model import floating_base_joints
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.verdict.result import Result, candidates_of


def locate(d: Result) -> list[tuple[str, str, float]]:
    """(name, kind, ratio to what noise explains), largest first.

    The recordings show the missing force joint by joint; the joints that place a floating base stand for its body. What
    was found at an actuator, a body, a geom (which goes by its body) or the whole world takes the largest ratio among
    the joints on which it acts; among equals, what was found stands first. Between commands and measured forces the
    ratio is that of the squared force errors of the model as given over those of the forces' noise.
    """
    p = d.prepared
    base = _base(p)
    by_joint = {name: ratio for name, kind, ratio in d.location if kind == "joint"} | base
    rows: dict[tuple[str, str], float] = {}
    for term in _named(d):
        place = term.place
        kind, name = place.kind, place.name
        if kind == "geom":
            kind, name = "body", p.names.bodies[int(p.model.geom_bodyid[place.index])]
        if kind in ("actuator", "body", "world"):
            joints = acted_on(p.model, place)
            ratios = [by_joint[p.names.joints[j]] for j in joints if p.names.joints[j] in by_joint]
            rows[name, kind] = max([rows.get((name, kind), 0.0), *ratios])
        elif name in by_joint and name not in base:
            rows[name, kind] = by_joint[name]
    for name in d.unexplained["at"] if d.unexplained is not None else ():
        if name in p.names.actuators and name not in by_joint:
            joints = acted_on(p.model, Place("actuator", name, p.names.actuators.index(name)))
            ratios = [by_joint.get(p.names.joints[j], 0.0) for j in joints]
            rows[name, "actuator"] = max([rows.get((name, "actuator"), 0.0), *ratios])
    if d.actuators is not None:
        rows |= {(name, "actuator"): ratio for name, ratio in d.actuators.excess.items()}
    for name, kind, ratio in d.location:
        if name not in base:
            rows.setdefault((name, kind), ratio)
    for name, ratio in base.items():
        joint = p.names.joints.index(name)
        key = (p.names.bodies[int(p.model.jnt_bodyid[joint])], "body")
        rows[key] = max(rows.get(key, 0.0), ratio)
    return sorted(((n, k, r) for (n, k), r in rows.items()), key=lambda row: -row[2])


def by_joint(p: Prepared, s: Search) -> list[tuple[str, str, float]]:
    """Where the nominal model lacks force: (place, kind, ratio to what noise explains), largest first."""
    white = s.whiten_one(NOTHING, s.train, temper=False)
    ratio, _ = excess_by_dof(s.sim, NOTHING, s.train, white)
    out: dict[str, float] = {}
    for d in active_dofs(p.model) or range(p.model.nv):
        name = p.names.joint_of_dof(p.model, d)
        out[name] = max(out.get(name, 0.0), float(ratio[d]))
    return [(n, "joint", e) for n, e in sorted(out.items(), key=lambda x: -x[1])]


def _base(p: Prepared) -> dict[str, float]:
    """Ratios of the joints that place a floating base in the world."""
    m = p.model
    joints = floating_base_joints(m)
    recordings = [s.recording for s in p.train]
    seen = [j for j in joints if not any(np.isnan(r.qpos[:, m.jnt_qposadr[j]]).all() for r in recordings)]
    if not seen:
        return {}
    w = p.windows("train", p.config.decide_s, p.config.train_windows)
    white = whitener(p.sim, NOTHING.hypothesis, NOTHING.theta, w, p.noise, temper=False)
    ratio, _ = excess_by_dof(p.sim, NOTHING, w, white)
    return {p.names.joints[j]: float(max(ratio[m.dof_jntid == j])) for j in sorted(seen)}


def _named(d: Result) -> list[Term]:
    """Terms that were found, then those that the recordings cannot tell from them."""
    tied = [t for fits in candidates_of(d).values() for f in fits for t in f.hypothesis.named]
    return list(dict.fromkeys([*d.terms, *tied]))
