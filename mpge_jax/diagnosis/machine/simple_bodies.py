"""What contacts, limits and friction take for the inertia of bodies that only slide.

MuJoCo takes the mass alone of a body that its compiler calls simple and that only slides: its `body_invweight0` and
`dof_invweight0` are 1 / mass, whatever the armature and the number of directions. A model whose masses may vary is
compiled without simple bodies, and its contacts would be harder, up to three times.
"""

from __future__ import annotations

import mujoco
import numpy as np

ONLY_SLIDES = 2
"""`body_simple` of such a body."""
ALIKE = 1e-9


def only_slide(model: mujoco.MjModel) -> np.ndarray:
    """[nbody] which bodies have slides and no other joint."""
    others = np.bincount(model.jnt_bodyid, model.jnt_type != mujoco.mjtJoint.mjJNT_SLIDE, model.nbody)
    return np.asarray((others == 0) & (model.body_jntnum > 0))


def as_compiled(model: mujoco.MjModel, plain: mujoco.MjModel) -> None:
    """Give a model the weights that the same one has where bodies may be simple (`plain`)."""
    for body in np.flatnonzero(plain.body_simple == ONLY_SLIDES):
        model.body_invweight0[body] = plain.body_invweight0[body]
        dofs = np.flatnonzero(plain.dof_bodyid == body)
        model.dof_invweight0[dofs] = plain.dof_invweight0[dofs]


def sliders(model: mujoco.MjModel) -> list[int]:
    """Bodies that only slide and whose weights are those of their masses alone."""
    of_mass = np.isclose(model.body_invweight0[:, 0] * model.body_mass, 1.0, rtol=ALIKE, atol=0.0)
    return np.flatnonzero(only_slide(model) & of_mass).tolist()
