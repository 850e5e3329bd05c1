"""Weights of bodies that only slide, after derived numbers of a model were told anew."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.step import Fields
from mpge_jax.diagnosis.machine.simple_bodies import sliders


def weigh_anew(f: Fields, nominal: mujoco.MjModel) -> None:
    """Give the nominal model's `sliders` the weights of the masses that they have now, after `mj_setConst` took them
    for other bodies."""
    for body in sliders(nominal):
        weight = 1.0 / f.get("body_mass", (body,))
        f.set("body_invweight0", (body, 0), weight)
        f.set("body_invweight0", (body, 1), 0.0 * weight)
        for dof in np.flatnonzero(nominal.dof_bodyid == body).tolist():
            f.set("dof_invweight0", (dof,), weight)
