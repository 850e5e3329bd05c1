"""Steps as fine as the recordings show that the machine moves in."""

from __future__ import annotations

from dataclasses import replace

import mujoco

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.inexact_inertias import with_free_inertias
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import STEP, whitener_beside
from mpge_jax.diagnosis.evidence.held_out_error import WINDOWS
from mpge_jax.diagnosis.evidence.numerics_seen import NUMERICS, numerics_seen

CLEARLY = 1.0
"""Amount of `STEP` beyond which that is so (1 stands for steps half as long, 2 for no steps at all): searches see past
what less does."""
FINER, QUARTER = (2, 4), 1.25
"""Steps in place of one of the model's then, and the amount from which on it is the more: it lies between those of
which half and a quarter of a step leave nothing."""
ITERATIONS = 8


def in_steps_as_seen(p: Prepared, f: Fitted = NOTHING) -> Prepared:
    """The same in finer steps than the model's where its recordings show clearly, beside what is known (`f`), that the
    machine moves as in these; a warning says so. No machine has a timestep, and what a coarse one does to fast motion
    may hide all that the model lacks, or pass for it. Where things touch, the model's steps are a part of its contacts,
    and stay.
    """
    if p.ctx.contacts or p.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return p
    amount = numerics_seen(p, _beside_masses(p, f))[0].get(STEP, 0.0)
    if amount <= CLEARLY:
        return p
    finer = replace(p, dt=p.dt / FINER[amount > QUARTER])
    p.warnings.append(
        f"{NUMERICS[STEP]}: all is simulated, and errors are told, in steps of {finer.dt:.3g} s instead of "
        f"{p.dt:.3g} s; give a corrected model such a timestep too."
    )
    return finer


def _beside_masses(p: Prepared, f: Fitted) -> Fitted:
    """`f` with the masses and inertias that fit beside it: what they are off by would pass for misfit of its own."""
    free = with_free_inertias(p.ctx, f, p.config.masses_within)
    w = p.all_to_train().windows("train", p.config.report_s, WINDOWS["train"], seed=1)
    if free is None or not w.count:
        return f
    white = whitener_beside(p.sim, f.hypothesis, f.theta, w, p.noise)
    return fit(p.sim, [free], w, white, iterations=ITERATIONS)[0]
