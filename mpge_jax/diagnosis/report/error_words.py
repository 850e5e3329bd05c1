"""How errors change, in words and with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.verdict.remainder_description import MOTION_ITSELF
from mpge_jax.diagnosis.verdict.result import Result, before_after_noise

OVERESTIMATED = 1.5
"""How many times what is left the noise's estimate may be for that to pass as noise. Errors of windows scatter; beyond
that something else, such as a rough command, was taken for noise."""
PLAINLY = 2.0
"""Times the noise from which on it is said how far an error is beyond it."""
OTHERWISE = 2.0
"""Times as much as all windows' by which the usual window's error must fall for that to be said too."""


def gain(d: Result) -> str:
    """How much better held-out recordings are predicted."""
    unit = error_unit(d)
    before, after, noise = before_after_noise(d.held)
    if isinstance(d.held, ForceErrors):
        what = "actuator force that the motion needs"
    else:
        what = f"motion over {d.held.windows.times.max():.2g} s"
    return (
        f"On recordings that were not used for fitting, the error of the predicted {what} {moves(before, after, unit)} "
        f"({beside_noise(after, noise, unit, not isinstance(d.held, ForceErrors))}){_usual_window(d.held, unit)}."
    )


def _usual_window(held: FitReport | ForceErrors, unit: str) -> str:
    """How the error of the usual window changes, where few windows hold most of it and hide that."""
    if isinstance(held, ForceErrors) or not held.floors.size:
        return ""
    before, after = (float(np.median(e.window)) for e in (held.before, held.after))
    if before / max(after, 1e-300) < OTHERWISE * held.before.rms / max(held.after.rms, 1e-300):
        return ""
    return f"; few windows hold most of it: that of the usual one {moves(before, after, unit)}"


def beyond_noise(d: Result) -> str:
    """How far the held-out error is beyond noise; nothing where that is not far."""
    _, after, noise = before_after_noise(d.held)
    return f" (the error is {times(noise, after)} what noise alone leaves)" if after > PLAINLY * noise else ""


def untold(d: Result) -> str:
    """What is said of motion errors in test recordings that are far beyond noise where the other recordings, which
    decide, left no more than noise; nothing where they are not, or where impacts do that, as a warning says."""
    if isinstance(d.held, ForceErrors) or d.ctx.contacts or d.held.after.rms <= PLAINLY * d.held.floor:
        return ""
    usual, noise = float(np.median(d.held.after.window)), float(np.median(d.held.floors))
    where = "In the test recordings" if usual > PLAINLY * noise else "In a few windows of the test recordings"
    return (
        f"{where} the error is still {times(d.held.floor, d.held.after.rms)} what noise and timestep alone leave; what "
        "that comes from, the other recordings do not tell."
    )


def moves(before: float, after: float, unit: str) -> str:
    """How an error changes: 'falls from 12 to 1 rad, 12 times smaller', or that it rises, hardly does, or stays."""
    if f"{before:.3g}" == f"{after:.3g}":
        return f"stays at {after:.3g} {unit}"
    verb, way = ("falls", "smaller") if after < before else ("rises", "larger")
    said, by = f"{verb} from {before:.3g} to {after:.3g} {unit}", times(before, after)
    return f"hardly {said}" if by == "1 times" else f"{said}, {by} {way}"


def times(before: float, after: float) -> str:
    """By how much an error became smaller or larger: '12 times'."""
    ratio = max(before, after) / max(min(before, after), 1e-300)
    return "more than 1000 times" if ratio > 1000 else f"{ratio:.3g} times"


def makes_up(unexplained: Mapping[str, Any]) -> str:
    """How much something is that has no name."""
    share, of = percent(unexplained["share"]), unexplained["of"]
    if of == MOTION_ITSELF:
        return (
            f"It makes up {share} of the squared motion, by far more than which the model as given misses it."
        )
    return f"It makes up {share} of the squared error of the {of} that the model as given predicts."


def percent(share: float) -> str:
    """'68 %', '1.7 %', '0.25 %'."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def worse_without(drop: float) -> str:
    """How much larger the error is without an effect, the others kept, from the share of the squared error that goes
    with it (`error_drops`): '3.2 times'."""
    if drop < 0:
        return "smaller"
    said = times(1.0, float(np.sqrt(max(1.0 - drop, 0.0))))
    return "hardly larger" if said == "1 times" else said


def beside_noise(after: float, noise: float, unit: str, moves: bool = True) -> str:
    """What is no missing physics does, beside what is left.

    Args:
        moves: whether a motion is predicted; forces along a given one hang on no timestep.
    """
    if noise < 0.999 * after:
        return f"{no_physics(moves)} {noise:.2g} {unit}"
    if noise <= OVERESTIMATED * after:
        return "that is no more than measurement noise leaves"
    return (
        f"how much of that is noise is unknown, as its estimate is too high: it would give {noise:.2g} {unit}"
    )


def no_physics(moves: bool) -> str:
    """What leaves errors though nothing is missing, of predicted motions or of forces."""
    return "noise and timestep alone give" if moves else "noise alone gives"


def error_unit(d: Result) -> str:
    """Unit of the errors: of positions over all joints together or, where the motion is given, of forces."""
    m = d.prepared.model
    measured = [
        not all(np.isnan(s.recording.qpos[:, q]).all() for s in d.prepared.train) for q in m.jnt_qposadr
    ]
    kinds = set(m.jnt_type[measured].tolist())
    if isinstance(d.held, ForceErrors):
        driven = [a for a in map(int, np.flatnonzero(d.prepared.measured)) if is_joint_transmission(m, a)]
        kinds = {int(m.jnt_type[m.actuator_trnid[a, 0]]) for a in driven}
        hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        return "N and N m" if len(kinds) > 1 else ("N m" if kinds == {hinge} else "N")
    if kinds <= {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}:
        return "rad"
    return "m" if kinds == {int(mujoco.mjtJoint.mjJNT_SLIDE)} else "rad and m"


def unit_of_motion(model: mujoco.MjModel, dof: int) -> str:
    """Unit of the position of one degree of freedom."""
    kind, first = model.jnt_type[model.dof_jntid[dof]], int(model.jnt_dofadr[model.dof_jntid[dof]])
    free = kind == mujoco.mjtJoint.mjJNT_FREE and dof - first < 3
    return "m" if free or kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad"


def unit_of_joint(d: Result, name: str) -> str:
    """Unit of one joint's errors, or of the force of what drives it; `name` as in the table of joints."""
    m, names = d.prepared.model, d.prepared.names
    joint = name if name in names.joints else name.partition(":")[0]
    if joint not in names.joints:
        return error_unit(d)
    dofs, number = np.flatnonzero(m.dof_jntid == names.joints.index(joint)), name.removeprefix(f"{joint}:")
    unit = unit_of_motion(m, int(next((dof for dof in dofs if str(dof) == number), dofs[0])))
    return {"m": "N", "rad": "N m"}[unit] if isinstance(d.held, ForceErrors) else unit
