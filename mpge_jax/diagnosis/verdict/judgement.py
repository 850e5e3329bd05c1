"""The verdict: whether what a fit leaves is more than noise and matters, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide, by_command
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
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
from mpge_jax.diagnosis.selection.remainder import Remainder, leaves
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import FAR, MEANS_SOMETHING, SLIGHT
from mpge_jax.diagnosis.verdict.beside_functions import without_needless
from mpge_jax.diagnosis.verdict.differing_recordings import as_recordings_differ
from mpge_jax.diagnosis.verdict.location import by_joint
from mpge_jax.diagnosis.verdict.part_of_unknown import (
    Beside,
    doubtful,
    joints_at,
    left_of_motion,
    left_there,
    matters,
)
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
    return held.before.rms > FAR * held.beside(*each).floor


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


@dataclass(frozen=True)
class _Rest:
    """What a fit leaves of the motion.

    Attributes:
        share: of the squared error. told: the entry of `unexplained`; None where that is nothing, or a detail. beside:
            what is left beside each effect that acts where it is. remainder: None where nothing is left.
    """

    share: float = 0.0
    told: dict[str, Any] | None = None
    beside: Mapping[Term, Beside] = field(default_factory=dict)
    remainder: Remainder | None = None


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
    shown, corrected = (p, found.fit), bool(found.fit.hypothesis.terms)
    if drives is not None and drives.fits and not corrected:
        shown, corrected = by_command(p, plain, drives), True
        held = fit_report(*shown, "test")
    train, held, stepped = _beside_numerics(p, found, shown, held)
    rest = _rest(p, s, found, held, corrected, certain=functions is not None)
    residual = functions
    if rest.told is not None and residual is None:
        s.say("modelling what is left")
        residual = residual_of_motion(p, s, found.fit, rest.told["at"], shown, held)
        if residual is not None:
            doubts = doubtful(rest.beside, None)
            fewer, its = without_needless(p, s, found, rest.told["at"], residual, held, doubts)
            if fewer is not found:
                return judge(p, plain, s, fewer, fit_report(p, fewer.fit, "test"), drives, its)
    if rest.told is None:
        p.warnings += [*stepped, *struck(p, found, held)]
    elif residual is not None:
        rest.told["when"] = residual.told(rest.told["when"])
    elif rest.remainder is not None:
        joints = dict.fromkeys(j for name in rest.told["at"] for j in joints_at(p, name))
        changing = [as_recordings_differ(p, rest.remainder, j) for j in joints]
        rest.told["when"] = "; ".join(filter(None, changing)) or rest.told["when"]
    unexplained = rest.told if drives is None else together([rest.told, *drives.left])
    whole = found.fit if residual is None else with_residual(p.ctx, found.fit, residual)
    doubts = () if unexplained is None else (*doubtful(rest.beside, drives), *may_be_none(s, found.fit))
    return Result(
        _verdict(found, drives, unexplained),
        p,
        found.fit,
        found.rivals,
        error_drops(p, whole, held.windows, found.fit.hypothesis.terms),
        train,
        held,
        by_joint(p, s),
        unexplained,
        list(dict.fromkeys(p.warnings)),
        p.config,
        s.log,
        drives,
        remainder=rest.share if unexplained is None else 0.0,
        residual=residual,
        doubtful=tuple(dict.fromkeys(doubts)),
    )


def _beside_numerics(
    p: Prepared, found: Decision, shown: tuple[Prepared, Fitted], held: FitReport
) -> tuple[FitReport, FitReport, list[str]]:
    """Errors on training and test recordings beside what noise and the timestep leave of them, and what is to be said
    of the timestep."""
    # windows of test recordings start from rows that are not compared: start and measurement are as independent there
    # as a floor takes them
    train = fit_report(*shown, "train").above(found.noise.ratio)
    amounts, stepped = numerics_seen(p, found.fit)
    machine, fit = shown
    train, held = (
        r.beside(numerical_floor(machine.sim, fit, r.windows, machine.noise, amounts)) for r in (train, held)
    )
    return train, held, stepped


def _rest(p: Prepared, s: Search, found: Decision, held: FitReport, corrected: bool, certain: bool) -> _Rest:
    """What is left, and whether it matters.

    Args:
        corrected: whether the errors `held` are those of a corrected model. certain: it matters.
    """
    left = found.left
    if left is None and not corrected and too_far(p, held):
        left = leaves(s, found.fit)
    if left is None:
        return _Rest()
    rugged = p.sim.rugged(left.fit.hypothesis)
    share = held.left(rugged) ** 2 if corrected else 1.0
    told = describe(p, left, share) | ({"of": MOTION_ITSELF} if held.flies_away else {})
    beside = left_of_motion(p, found.fit, told["at"], held)
    there = left_there(p, told["at"], held, rugged)
    if not (certain or there or held.before.rms > held.floor):
        # what only velocities show no prediction misses
        return _Rest()
    if share <= SLIGHT < there:
        told |= {"share": number(there), "of": MOTION_THERE}
    return _Rest(share, told if certain or matters(max(share, there), beside) else None, beside, left)


def _verdict(found: Decision, drives: ActuatorSide | None, unexplained: dict[str, Any] | None) -> str:
    if unexplained is not None:
        return "unexplained"
    if any(r.tied for rivals in found.rivals.values() for r in rivals):
        return "ambiguous"
    named = found.fit.hypothesis.named or (drives is not None and drives.fits)
    return "effects" if named else "none"
