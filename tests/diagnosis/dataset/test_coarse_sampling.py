"""Noise of logs whose rows lie far apart, by what single intervals are mispredicted by."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from tests.diagnosis.machines import ARM
from tests.diagnosis.searches import prepared_of

EVERY = 0.05
"""Seconds between rows."""


def _recordings(noise: float) -> list[Recording]:
    """An arm under commands drawn anew at each row, whose state is measured with `noise` (rad; ten times that in
    rad/s)."""
    model, rng, out = mujoco.MjModel.from_xml_string(ARM), np.random.default_rng(3), []
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        data.qpos[:] = rng.uniform(-1.0, 1.0, 2)
        for _ in range(120):
            data.ctrl[:] = rng.uniform(-1.0, 1.0, 2) * [4.0, 0.8]
            rows.append(np.concatenate([data.qpos, data.qvel, data.ctrl]))
            for _ in range(round(EVERY / model.opt.timestep)):
                mujoco.mj_step(model, data)
        q, v, u = np.split(np.array(rows), 3, axis=1)
        q, v = q + noise * rng.standard_normal(q.shape), v + 10.0 * noise * rng.standard_normal(v.shape)
        out.append(Recording(f"run_{k}", EVERY * np.arange(120), q, v, u))
    return out


@pytest.mark.parametrize("noise", [0.003, 0.01])
def test_a_miss_holds_the_noise_of_two_rows(noise):
    """What a prediction misses by is compared with the noise that the rows were given."""
    p = prepared_of(ARM, _recordings(noise))
    assert p.noise.direct
    np.testing.assert_allclose(p.noise.qpos, noise, rtol=0.2)
    np.testing.assert_allclose(p.noise.qvel, 10.0 * noise, rtol=0.2)


def test_noise_free_rows_are_that():
    p = prepared_of(ARM, _recordings(0.0))
    assert (p.noise.qpos <= 1e-6).all() and (p.noise.qvel <= 1e-5).all()
