"""Describe what no effect explains: at which joint, when, and how much of the error it is."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.intervals import number
from mpge_jax.diagnosis.estimation.missing_force import Probed, active_dofs, probed
from mpge_jax.diagnosis.machine.model import is_joint_transmission, is_scalar, moments
from mpge_jax.diagnosis.selection.remainder import Remainder
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
ELSEWHERE = 3.0
"""How many times as much force at a floating base alone must explain as force at any joint alone for its body to be the
place."""
ALIKE = 0.3
"""Share of what force at the likeliest joint alone explains, by which that at another must explain less not to be named
beside it."""
ALONG, DIFFERENT = 0.5, 25.0
"""Share of the missing force's chi^2 that may be left, and of what any other actuator or joint would leave, where one
actuator's force is to explain it; and by how much chi^2 it must be better than they."""

MOTION_ITSELF, MOTION_THERE = "motion itself", "motion there"
"""Of what something without a name is a share, where the model as given misses far more than the machine moves, and
where it is a detail of what all joints were missed by, and none of that at its own."""


def _rank_correlation(a: Array, b: Array) -> float:
    if a.size < 5 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    ra, rb = (np.argsort(np.argsort(x)).astype(float) for x in (a, b))
    return float(np.corrcoef(ra, rb)[0, 1])


def _drive(p: Prepared, w: Windows, missing: Probed) -> tuple[int, Array] | None:
    """The actuator, of those that drive no single joint (rotors) and whose force nobody measured, along which most of
    the missing force lies, and its moments [W, nv]."""
    m = p.model
    several = [a for a in range(m.nu) if not is_joint_transmission(m, a) and not p.measured[a]]
    if not several or not w.count:
        return None
    data, along = mujoco.MjData(m), np.zeros((w.count, m.nu + m.nv, m.nv))
    for k in range(w.count):
        data.qpos[:] = w.q0[k]
        mujoco.mj_fwdPosition(m, data)
        along[k] = np.concatenate([moments(m, data), np.eye(m.nv)])
    explained, whole = (x.sum(0) for x in missing.along(along))
    first = max(several, key=lambda a: explained[a])
    left, other = whole - explained[first], whole - np.delete(explained, first).max()
    sure = left < ALONG * whole and left + DIFFERENT < ALONG * other
    return (first, along[:, first]) if sure else None


def _likeliest(missing: tuple[Probed, Probed], joints: list[int]) -> list[int]:
    """The degree of freedom at which missing force alone leaves least, and another one that does so nearly as well: of
    joints, unless force at a floating base explains far more.

    Force that is allowed everywhere at once (`Probed.by_dof`) finds some at every joint where windows last longer than
    the force does, or contacts scatter them.

    Args:
        joints: degrees of freedom that are no floating base's.
    """
    lefts, wholes = [], []
    for part in missing:
        windows, nv = part.push.shape
        alone, whole = part.along(np.broadcast_to(np.eye(nv), (windows, nv, nv)))
        lefts.append(np.maximum(whole[:, None] - alone, 0.0))
        wholes.append(whole)
    # few windows may be beyond all measure
    left, whole = (np.log1p(np.concatenate(x)).mean(0) for x in (lefts, wholes))
    explained = whole - left
    if explained.max() > ELSEWHERE * explained[joints].max():
        return [int(np.argmax(explained))]
    first, *others = sorted(joints, key=lambda d: left[d])[:2]
    return [first, *(d for d in others if left[d] - left[first] < ALIKE * explained[first])]


def in_words(force: Array, clues: dict[str, Array], directions: tuple[str, str]) -> str:
    """On what the size of missing force [W] depends, and which way it acts, in words."""
    found = {k: _rank_correlation(np.abs(force), v) for k, v in clues.items()}
    name, strength = max(found.items(), key=lambda x: abs(x[1]))
    if abs(strength) > 0.45:
        when = f"it grows {'with' if strength > 0 else 'as'} the {name}{'' if strength > 0 else ' falls'}"
    else:
        known = [
            k for k in ("angle", "speed", "command", "force", "time") if any(k in clue for clue in clues)
        ]
        when = f"it depends neither on {', '.join(known[:-1])} nor {known[-1]} in a simple way"
    sign = float(np.sign(force).mean())
    return when + (f"; it always {directions[0 if sign > 0 else 1]}" if abs(sign) > 0.8 else "")


def describe(p: Prepared, left: Remainder, share: float) -> dict[str, Any]:
    """The `unexplained` entry of a diagnosis.

    Args:
        share: share of the held-out squared error that remains.
    """
    s = left.search
    train, held = (
        probed(s.sim, left.fit, w, white) for w, white in zip((s.train, s.held), left.whites, strict=True)
    )
    _, force = train.by_dof()
    joints = active_dofs(p.model) or list(range(p.model.nv))
    order = _likeliest((train, held), joints)
    w, worst = s.train, order[0]
    at = [p.names.joint_of_dof(p.model, d) for d in order]
    if worst not in joints:
        at = [p.names.bodies[int(p.model.dof_bodyid[worst])]]
    at, missing = list(dict.fromkeys(at)), force[:, worst]
    directions = ("pushes forwards", "pushes backwards")
    sizes = {}
    for a, name in enumerate(p.names.actuators):
        what = "measured force" if p.by_force[a] else "command"
        sizes[f"size of the {what} of {name}"] = np.abs(w.command[:, w.history :, a]).mean(1)
    joint = int(p.model.dof_jntid[worst])
    clues = {"speed of the joint": np.abs(w.v0[:, worst]), "time since the start": w.start, **sizes}
    if is_scalar(p.model, joint):
        clues["angle of the joint"] = w.q0[:, int(p.model.jnt_qposadr[joint])]
    drive = _drive(p, w, train)
    if drive is not None:
        actuator, moment = drive
        at = [p.names.actuators[actuator]]
        missing = (force * moment).sum(1) / np.maximum((moment**2).sum(1), 1e-300)
        gain = p.model.actuator_gainprm[actuator, 0]
        missing = missing * np.sign(gain * w.command[:, w.history :, actuator].mean(1))
        clues = {"time since the start": w.start, **sizes}
        directions = ("adds to its force", "takes from its force")
    when = in_words(missing, clues, directions)
    top = np.argsort(-left.left.losses[: w.count])[: min(8, w.count)]
    length = w.times.max(1)
    intervals = []
    for k in sorted(top, key=lambda k: (w.source[k], w.start[k])):
        r = w.sources[w.source[k]].recording
        begin = r.origin + float(w.start[k])
        intervals.append([r.name, round(begin, 4), round(begin + float(length[k]), 4)])
    return {"at": at, "when": when, "intervals": intervals, "share": number(min(share, 1.0)), "of": "motion"}
