"""Short recordings of a machine whose commands come late: what was commanded before them, no recording tells."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.whitening import BEFORE, nuisances
from mpge_jax.diagnosis.selection.remainder import leaves
from tests.diagnosis.machines import FINE_PENDULUM
from tests.diagnosis.searches import DAMPING, MOTOR, fitted, search_of

DELAY = Term("actuator_delay", MOTOR)
LATE, RATE, ROWS, FIRST = 2, 50, 30, 0.0
"""Rows by which commands are late, rows a second and in all, and the command before the first."""


@pytest.fixture(scope="module")
def episodes() -> list[Recording]:
    model = mujoco.MjModel.from_xml_string(FINE_PENDULUM)
    rng, out = np.random.default_rng(0), []
    for k in range(16):
        data, rows, held = mujoco.MjData(model), [], [FIRST] * LATE
        data.qpos[:] = rng.uniform(-1, 1)
        for i in range(ROWS):
            u = float(np.clip(1.5 + rng.normal(), -2, 2))
            rows.append((i / RATE, data.qpos[0] + 1e-5 * rng.standard_normal(), u))
            held.append(u)
            data.ctrl[0] = held.pop(0)
            mujoco.mj_step(model, data, round(1 / RATE / model.opt.timestep))
        t, q, u = np.array(rows).T
        out.append(Recording(f"episode_{k:02d}", t, q[:, None], None, u[:, None]))
    return out


def test_what_was_commanded_before_counts_for_late_actuators_at_the_beginning_alone(episodes):
    s, _ = search_of(FINE_PENDULUM, episodes)
    f = fitted(s, {DELAY: [LATE / RATE]})
    changes = nuisances(s.sim, f.hypothesis, f.theta, s.train)
    (change,) = [x for kind, x in changes.items() if kind.startswith(BEFORE)]
    early = s.train.start < LATE / RATE - 1e-9
    assert 0 < early.sum() < early.size
    assert (np.nanmax(np.abs(change), axis=(1, 2)) > 0).tolist() == early.tolist()
    # the truth leaves noise, also of windows that begin where the commands are not known
    assert leaves(s, f).left.losses.max() < 3.0
    prompt = fitted(s, {DAMPING: [0.1]})
    assert not any(k.startswith(BEFORE) for k in nuisances(s.sim, prompt.hypothesis, prompt.theta, s.train))
