"""What is named where something acts that has no name: whether it may be a part of that.

A law that is only like what acts takes much of the error away, and leaves the rest at its own place. A name is certain
there only where what is left is slight beside what it explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, errors_without, fit_report, left_at_joints
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
from mpge_jax.diagnosis.evidence.numerics_seen import amounts_seen
from mpge_jax.diagnosis.selection.procedure import Found
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import MEANS_SOMETHING, SLIGHT

Array = np.ndarray
UNKNOWN = "unexplained"
"""Identifier, among candidates, of what has no name."""


@dataclass(frozen=True)
class Beside:
    """Of the squared error without an effect, noise aside, the share that is left with it: where something is left, and
    over all joints on which the effect acts."""

    there: float
    own: float


def left_beside(
    p: Prepared,
    at: Sequence[str],
    after: Array,
    without: Mapping[Term, Array],
    floor: Array | float,
    columns: Sequence[Sequence[int]],
) -> dict[Term, Beside]:
    """What is left beside every effect that acts where something is left, and is physics that a verdict names.

    Args:
        at: where something is left: joints, actuators, or the bodies of floating bases. after: [n] rms errors with all
            effects. without: the same without each. floor: what noise leaves of them. columns: the joints of which each
            of these errors tells.
    """
    here = {j for name in at for j in joints_at(p, name)}

    def share(error: Array, joints: set[int]) -> float:
        shown = np.array([bool(joints.intersection(of)) for of in columns])
        left, whole = (
            float(np.nansum(np.maximum(x**2 - np.square(floor), 0.0)[shown])) for x in (after, error)
        )
        return left / max(whole, 1e-300)

    its = {term: set(acted_on(p.model, term.place)) for term in without if term.effect.named}
    return {
        term: Beside(share(without[term], here), share(without[term], joints))
        for term, joints in its.items()
        if here & joints
    }


def left_of_motion(p: Prepared, f: Fitted, at: Sequence[str], report: FitReport) -> dict[Term, Beside]:
    """What is `left_beside` the effects of a fit in the windows of a report."""
    each = {t: report.no_more_than_moved(e.joint) for t, e in errors_without(p, f, report).items()}
    return left_beside(p, at, report.after.joint, each, report.joint_floors, [[j] for j in p.model.dof_jntid])


def left_there(p: Prepared, at: Sequence[str], report: FitReport, rugged: bool) -> float:
    """What is `left_at` a joint where something is left; the most of these. It may drown in what others had. 0 where
    things strike each other, as impacts leave as much.

    Args:
        at, report: as in `left_of_motion`.
    """
    return 0.0 if rugged else left_at_joints(p, report, {j for name in at for j in joints_at(p, name)})


def matters(share: float, beside: Mapping[Term, Beside]) -> bool:
    """Whether what is left is more than a detail, also beside each of the effects that act where it is.

    Args:
        share: of the squared error. beside: what is left beside each such effect.
    """
    return max([share, *(left.there for left in beside.values())]) > SLIGHT


def slightly_left(p: Prepared, s: Search, found: Found, at: Sequence[str]) -> bool:
    """Whether what is left at some places is at most a detail of recordings that only choose, or of their noise."""
    report = fit_report(p, found.fit, "choice", amounts_seen(p, found.fit))
    if report.after.rms <= MEANS_SOMETHING * report.floor:
        return True
    rugged = s.sim.rugged(found.fit.hypothesis)
    share = max(report.left(rugged) ** 2, left_there(p, at, report, rugged))
    return not matters(share, left_of_motion(p, found.fit, at, report))


def joints_at(p: Prepared, name: str) -> list[int]:
    """Joints that a place of what is left stands for: a joint, an actuator, or the body of a floating base."""
    if name in p.names.joints:
        return [p.names.joints.index(name)]
    if name in p.names.actuators:
        return acted_on(p.model, Place("actuator", name, p.names.actuators.index(name)))
    return [int(j) for j in np.flatnonzero(p.model.jnt_bodyid == p.names.bodies.index(name))]


def doubtful(beside: Mapping[Term, Beside], drives: ActuatorSide | None) -> tuple[Term, ...]:
    """Effects that may be a part of what is left, as that is not slight beside them; those of drives too, of which
    something is left between command and measured force.

    Args:
        beside: what is `left_beside` them.
    """
    parts = [t for t, left in beside.items() if left.own > SLIGHT]
    if drives is not None:
        odd = {name for entry in drives.left for name in entry["at"]}
        parts += [t for t, drop in drives.drops.items() if t.place.name in odd and 1.0 - drop > SLIGHT]
    return tuple(parts)
