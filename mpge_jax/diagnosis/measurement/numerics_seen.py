"""Whether recordings move as with another timestep, integrator or moment of the commands than the model's."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.whitening import (
    INTEGRATOR,
    LATE,
    NUISANCE,
    STEP,
    column_scale,
    numerics,
    whitener,
)
from mpge_jax.diagnosis.evidence.held_out_error import WINDOWS
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows

SEEN, MOST = 6.0, 3.0
"""Deviations from nothing at which differences of timing count as seen, and how many of those that whitening allows for
they may be."""
NUMERICS = {
    STEP: "the recordings move as with a finer timestep than the model's",
    LATE: "commands act at another moment within a timestep than the model has it",
    INTEGRATOR: "the recordings move as with another integrator than the model's",
}
"""What is said of `numerics` where they are seen; of Runge-Kutta the first is another integrator too."""
FINER = 4
"""Steps in place of one of the model's where the recordings show that the machine moves as in finer ones."""
HALFWAY = 1.0
"""Amount of `STEP` that stands for steps half as long, beyond which the recordings are nearer to ever finer ones."""


def numerics_seen(p: Prepared, f: Fitted, w: Windows) -> tuple[dict[str, float], list[str]]:
    """An integrator, timestep or late commands behind the recordings that are not the model's: how much of each of
    `numerics`, which searches see past, is clearly there, and warnings with the size of what they change."""
    nv = p.model.nv
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise, temper=False)
    residual = p.sim.residuals([Run(f.hypothesis, f.theta)], w)[0]
    flat = white(residual)
    changes = numerics(p.sim, f.hypothesis, f.theta, w)
    weight = 1.0 / (1.0 + white.excess(flat) / 5.0)
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
        sure = amount[k] > SEEN * np.sqrt(max(variance[k], 0.0)) and amount[k] < MOST * NUISANCE
        if not (sure and matters):
            continue
        amounts[kind] = float(amount[k])
        if kind in NUMERICS and not any(x.startswith(NUMERICS[kind]) for x in p.warnings):
            what = NUMERICS[kind if INTEGRATOR in changes or kind == LATE else INTEGRATOR]
            warnings.append(
                f"{what}: {size.max():.1g} rad or m (rms, at the joint where it is most) over {w.times.max():.2g} s. "
                "This is taken into account and is not counted as missing physics."
            )
    return amounts, warnings


def in_steps_as_seen(p: Prepared) -> Prepared:
    """The same in finer steps than the model's where its recordings show clearly that the machine moves as in these; a
    warning says so. No machine has a timestep, and what a coarse one does to fast motion may hide all that the model
    lacks, or pass for it. Where things touch, the model's steps are a part of its contacts, and stay.
    """
    w = p.all_to_train().windows("train", p.config.report_s, WINDOWS["choice"], seed=1)
    if not w.count or p.ctx.contacts or p.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return p
    if numerics_seen(p, NOTHING, w)[0].get(STEP, 0.0) <= HALFWAY:
        return p
    finer = replace(p, dt=p.dt / FINER)
    p.warnings.append(
        f"{NUMERICS[STEP]}: all is simulated, and errors are told, in steps of {finer.dt:.3g} s instead of "
        f"{p.dt:.3g} s; give a corrected model such a timestep too."
    )
    return finer
