"""Whether recordings move as with another timestep, integrator or moment of the commands than the model's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.prediction_error import NO_AMOUNTS
from mpge_jax.diagnosis.estimation.whitening import (
    HOLDING,
    INTEGRATOR,
    LATE,
    LATER,
    NUISANCE,
    STEP,
    column_scale,
    numerics,
    robust_weight,
    whitener,
)
from mpge_jax.diagnosis.evidence.held_out_error import WINDOWS
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.thresholds import MOST_SEEN, SEEN

NUMERICS = {
    STEP: "the recordings move as with a finer timestep than the model's",
    LATE: "all commands act later than the model has it",
    INTEGRATOR: "the recordings move as with another integrator than the model's",
    HOLDING: "the dry friction that the model gives holds otherwise than MuJoCo's, which creeps",
}
"""What is said of `numerics` where they are seen; of Runge-Kutta the first is another integrator too."""


def amounts_seen(p: Prepared, f: Fitted) -> Mapping[str, float]:
    """How much of each of `numerics` is clearly there beside what was found; nothing where nothing was, or where things
    touch: the model's steps are a part of its contacts."""
    return numerics_seen(p, f)[0] if f.hypothesis.terms and not p.ctx.contacts else NO_AMOUNTS


def numerics_seen(p: Prepared, f: Fitted) -> tuple[dict[str, float], list[str]]:
    """An integrator, timestep or late commands behind the recordings that are not the model's: how much of each of
    `numerics`, which searches see past, is clearly there, and warnings with the size of what they change. Told by
    windows of the reported length of all that may be looked at."""
    w, nv = p.all_to_train().windows("train", p.config.report_s, WINDOWS["choice"], seed=1), p.model.nv
    if not w.count:
        return {}, []
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise, temper=False)
    residual = p.sim.residuals([Run(f.hypothesis, f.theta)], w)[0]
    flat = white(residual)
    changes = numerics(p.sim, f.hypothesis, f.theta, w)
    weight = robust_weight(white.excess(flat))
    columns = np.stack([white(residual + change) - flat for change in changes.values()])
    gram = np.einsum("w,pwm,qwm->pq", weight, columns, columns, optimize=True)
    inverse = np.linalg.pinv(gram, hermitian=True)
    amount = -inverse @ np.einsum("w,pwm,wm->p", weight, columns, flat, optimize=True)
    left = flat + np.einsum("p,pwm->wm", amount, columns)
    scores = np.einsum("w,pwm,wm->wp", weight, columns, left, optimize=True)
    # misfit comes by the window
    variance = np.maximum(np.diag(inverse), np.diag(inverse @ scores.T @ scores @ inverse))
    seen = np.isfinite(residual[..., :nv])
    amounts, warnings = {}, []
    for k, (kind, change) in enumerate(changes.items()):
        moved = np.where(seen, amount[k] * np.nan_to_num(change[..., :nv]), 0.0)
        size = np.sqrt((moved**2).sum((0, 1)) / np.maximum(seen.sum((0, 1)), 1))
        matters = bool((size > column_scale(p.noise, p.model)[:nv])[seen.any((0, 1))].any())
        sure = amount[k] > SEEN * np.sqrt(max(variance[k], 0.0)) and amount[k] < MOST_SEEN * NUISANCE
        if not (sure and matters):
            continue
        amounts[kind] = float(amount[k])
        if kind in NUMERICS and not any(x.startswith(NUMERICS[kind]) for x in p.warnings):
            what = NUMERICS[INTEGRATOR if kind == STEP and INTEGRATOR not in changes else kind]
            if kind == LATE:
                # what no motion tells from it, a reader may know
                what += f" by {1e3 * amount[k] * LATER * w.dt:.2g} ms, as with a delay common to all drives"
            warnings.append(
                f"{what}: {size.max():.1g} rad or m (rms, at the joint where it is most) over {w.times.max():.2g} s. "
                "This is taken into account and is not counted as missing physics."
            )
    return amounts, warnings
