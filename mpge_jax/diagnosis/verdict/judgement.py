"""The verdict: whether what a fit leaves is more than noise and matters, and what is said of it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide, by_command
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.intervals import number
from mpge_jax.diagnosis.estimation.prediction_error import numerical_floor
from mpge_jax.diagnosis.estimation.whitening import INTEGRATOR, LATE, STEP
from mpge_jax.diagnosis.evidence.held_out_error import (
    FitReport,
    error_drops,
    fit_report,
)
from mpge_jax.diagnosis.evidence.numerics_seen import numerics_seen
from mpge_jax.diagnosis.residual.model import ResidualModel, with_residual
from mpge_jax.diagnosis.residual.motion import residual_of_motion
from mpge_jax.diagnosis.selection.criteria import may_be_none
from mpge_jax.diagnosis.selection.procedure import Decision
from mpge_jax.diagnosis.selection.remainder import leaves
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import FAR, MEANS_SOMETHING, SLIGHT
from mpge_jax.diagnosis.verdict.beside_functions import without_needless
from mpge_jax.diagnosis.verdict.location import by_joint
from mpge_jax.diagnosis.verdict.part_of_unknown import doubtful, left_of_motion, left_there, matters
from mpge_jax.diagnosis.verdict.remainder_description import MOTION_ITSELF, MOTION_THERE, describe
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray


def together(entries: list[dict[str, Any] | None]) -> dict[str, Any] | None:
    """One `unexplained` entry for several; its share is the first one's, of the motion if that is among them."""
    known = [e for e in entries if e is not None]
    if len(known) < 2:
        return known[0] if known else None
    return {
        "at": list(dict.fromkeys(at for e in known for at in e["at"])),
        "when": "; ".join(f"at the {' and '.join(e['at'])} {e['when']}" for e in known),
        "intervals": [i for e in known for i in e["intervals"]],
        "share": known[0]["share"],
        "of": known[0]["of"],
    }


def too_far(p: Prepared, held: FitReport) -> bool:
    """Whether the error of the model as given is `FAR` beyond all that noise and `numerics`, clearly there or not,
    leave of it."""
    if held.before.rms <= FAR * held.floor:
        return False
    # what else is allowed is simulated only where it matters
    kinds = (STEP, LATE, INTEGRATOR)
    each = [numerical_floor(p.sim, NOTHING, held.windows, p.noise, {kind: 1.0}) for kind in kinds]
    return held.before.rms > FAR * held.beside(np.sum(each, axis=0)).floor


def struck(p: Prepared, found: Decision, held: FitReport) -> list[str]:
    """What is said where impacts leave far more than noise and that is not counted as missing physics."""
    if not p.ctx.contacts or held.after.rms <= MEANS_SOMETHING * held.floor:
        return []
    whose = "the corrected model" if found.fit.hypothesis.terms else "the model"
    w, worst = held.windows, int(np.argmax(held.after.window))
    where = f"most {w.start[worst]:.3g} s into {w.sources[w.source[worst]].recording.log}"
    return [
        f"impacts make slight differences large: test recordings are missed by {held.after.rms / held.floor:.2g} times "
        f"what noise alone leaves ({where}), recordings that {whose} makes itself, with the same noise and in its own "
        f"or in finer steps, by {found.noise.missed:.2g} times."
    ]


def judge(
    p: Prepared,
    plain: mujoco.MjModel,
    s: Search,
    found: Decision,
    held: FitReport,
    drives: ActuatorSide | None,
    functions: ResidualModel | None = None,
) -> Result:
    """The verdict on what was found of the machine and of its drives.

    Args:
        plain: the nominal model. s: the search that decided. held: errors on test recordings. drives: None where no
            force was measured. functions: of what has no name, for which effects were given up: then it matters.
    """
    shown = p, found.fit
    corrected = bool(found.fit.hypothesis.terms)
    if drives is not None and drives.fits:
        if not corrected:
            shown = by_command(p, plain, drives)
            held = fit_report(*shown, "test")
        corrected = True
    # windows of test recordings start from rows that are not compared: start and measurement are as independent there
    # as a floor takes them
    train = fit_report(*shown, "train").above(found.noise.ratio)
    amounts, stepped = numerics_seen(p, found.fit)
    train, held = (
        r.beside(numerical_floor(shown[0].sim, shown[1], r.windows, shown[0].noise, amounts))
        for r in (train, held)
    )
    left, share = found.left, 0.0
    if not corrected and left is None and too_far(p, held):
        left = leaves(s, found.fit)
    if left is not None:
        share = held.left(p.sim.rugged(left.fit.hypothesis)) ** 2 if corrected else 1.0
    unexplained, residual, beside = None, None, {}
    if left is not None:
        told = describe(p, left, share)
        told |= {"of": MOTION_ITSELF} if held.flies_away else {}
        beside = left_of_motion(p, found.fit, told["at"], held)
        there = left_there(p, told["at"], held, p.sim.rugged(left.fit.hypothesis))
        if share <= SLIGHT < there:
            told |= {"share": number(there), "of": MOTION_THERE}
        unexplained = told if functions or matters(max(share, there), beside) else None
    if unexplained is not None:
        residual = functions
        if residual is None:
            s.say("modelling what is left")
            residual = residual_of_motion(p, s, found.fit, unexplained["at"], shown, held)
            if residual is not None:
                fewer, its = without_needless(
                    p, s, found, unexplained["at"], residual, held, doubtful(beside, None)
                )
                if fewer is not found:
                    return judge(p, plain, s, fewer, fit_report(p, fewer.fit, "test"), drives, its)
        if residual is not None:
            unexplained["when"] = residual.told(unexplained["when"])
    if unexplained is None:
        p.warnings += stepped
        p.warnings += struck(p, found, held)
    if drives is not None:
        unexplained = together([unexplained, *drives.left])
    whole = found.fit if residual is None else with_residual(p.ctx, found.fit, residual)
    drop = error_drops(p, whole, held.windows, found.fit.hypothesis.terms)
    if unexplained is not None:
        verdict = "unexplained"
    elif any(r.tied for rivals in found.rivals.values() for r in rivals):
        verdict = "ambiguous"
    else:
        named = found.fit.hypothesis.named or (drives is not None and drives.fits)
        verdict = "effects" if named else "none"
    location, warnings = by_joint(p, s), list(dict.fromkeys(p.warnings))
    doubts = () if unexplained is None else (*doubtful(beside, drives), *may_be_none(s, found.fit))
    return Result(
        verdict,
        p,
        found.fit,
        found.rivals,
        drop,
        train,
        held,
        location,
        unexplained,
        warnings,
        p.config,
        s.log,
        drives,
        remainder=share if unexplained is None else 0.0,
        residual=residual,
        doubtful=tuple(dict.fromkeys(doubts)),
    )
