"""Noise of logs of whole states whose rows lie far apart: bounded by what predictions from row to row miss."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from mpge_jax.diagnosis import Recording
from tests.diagnosis.searches import prepared_of

LINK = """<body name="b{k}" pos="{at} 0 0"><joint name="j{k}" axis="0 1 0" damping="0.2" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" contype="0" conaffinity="0"/>{inner}</body>"""
CHAIN = f"""<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>{
    LINK.format(k=1, at=0, inner=LINK.format(k=2, at=0.3, inner=LINK.format(k=3, at=0.3, inner="")))
}</worldbody><actuator><motor name="m1" joint="j1" gear="8"/><motor name="m2" joint="j2" gear="5"/>
<motor name="m3" joint="j3" gear="2"/></actuator></mujoco>"""
NOISE, VELOCITY_NOISE = 1e-3, 2e-2


def recorded(strap: float, noisy: bool = True) -> list[Recording]:
    """Transitions of a learner's task, five of the model's steps each: commands at random, the first two joints
    strapped to each other."""
    model, rng, out = mujoco.MjModel.from_xml_string(CHAIN), np.random.default_rng(0), []
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        for _ in range(100):
            data.ctrl[:] = rng.uniform(-1, 1, 3)
            rows.append(np.concatenate([data.qpos, data.qvel, data.ctrl]))
            for _ in range(5):
                data.qfrc_applied[:2] = -strap * (data.qpos[0] + data.qpos[1])
                mujoco.mj_step(model, data)
        q, v, u = np.split(np.array(rows), 3, axis=1)
        if noisy:
            q, v = q + NOISE * rng.standard_normal(q.shape), v + VELOCITY_NOISE * rng.standard_normal(v.shape)
        out.append(Recording(f"run_{k}", 0.05 * np.arange(100), q, v, u))
    return out


def test_noise_is_what_predictions_miss():
    noise = prepared_of(CHAIN, recorded(strap=0.0)).noise
    assert noise.direct
    np.testing.assert_allclose(noise.qpos, NOISE, rtol=0.2)
    np.testing.assert_allclose(noise.qvel, VELOCITY_NOISE, rtol=0.2)


def test_noise_is_told_beside_forces_that_no_effect_explains():
    """The joint that the strap does not pull tells the noise; differences of rows say 45 times as much."""
    noise = prepared_of(CHAIN, recorded(strap=12.0)).noise
    assert noise.direct
    assert 1.1 * noise.qpos[2] > NOISE and noise.qpos[2] < 3.0 * NOISE
    assert 1.1 * noise.qvel[2] > VELOCITY_NOISE and noise.qvel[2] < 3.0 * VELOCITY_NOISE


def test_noise_of_a_worse_encoder_is_no_force():
    worse = [
        dataclasses.replace(r, qvel=r.qvel + [0.0, 0.2, 0.0] * rng.standard_normal(r.qvel.shape))
        for rng in [np.random.default_rng(1)]
        for r in recorded(strap=0.0)
    ]
    noise = prepared_of(CHAIN, worse).noise
    assert noise.direct
    np.testing.assert_allclose(
        noise.qvel, [VELOCITY_NOISE, np.hypot(VELOCITY_NOISE, 0.2), VELOCITY_NOISE], rtol=0.4
    )
