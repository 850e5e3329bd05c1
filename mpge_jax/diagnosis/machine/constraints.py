"""Generalised forces that constraints could make: contacts that are closed, and loops of bodies that are coupled."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

Array = np.ndarray
_KIND = mujoco.mjtConstraint
LOOPS = (_KIND.mjCNSTR_EQUALITY,)
CONTACTS_AND_LOOPS = (
    *LOOPS,
    _KIND.mjCNSTR_CONTACT_FRICTIONLESS,
    _KIND.mjCNSTR_CONTACT_PYRAMIDAL,
    _KIND.mjCNSTR_CONTACT_ELLIPTIC,
)


def without_loops(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with nothing coupled: bodies of a loop hang on one side only. The model itself where it has none."""
    if not model.neq:
        return model
    open_ = copy.copy(model)
    open_.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    return open_


def coupled(model: mujoco.MjModel) -> Array:
    """Degrees of freedom [nv] that the model's equality constraints couple or hold: none of them moves alone."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return (_jacobian(model, data, LOOPS) != 0.0).any(0)


def free_of_constraints(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Projector [nv, nv] of generalised forces onto those that no forces in present contacts or in loops make. Forces
    on single degrees of freedom are alike where their work on them at rest is (f^2 / M)."""
    jacobian = _jacobian(model, data, CONTACTS_AND_LOOPS)
    if not len(jacobian):
        return np.eye(model.nv)
    weight = 1.0 / np.sqrt(model.dof_M0)
    basis, singular, _ = np.linalg.svd((jacobian * weight).T, full_matrices=False)
    basis = basis[:, singular > 1e-6 * singular.max(initial=0.0)]
    return np.eye(model.nv) - (basis @ basis.T) * weight[None, :] / weight[:, None]


def _jacobian(model: mujoco.MjModel, data: mujoco.MjData, kinds: tuple[mujoco.mjtConstraint, ...]) -> Array:
    """Rows [n, nv] of the constraints of some kinds."""
    rows = np.isin(data.efc_type[: data.nefc], kinds)
    if not rows.any():
        return np.zeros((0, model.nv))
    jacobian = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        jacobian[:] = data.efc_J.reshape(-1, model.nv)[: data.nefc]
    return jacobian[rows]
