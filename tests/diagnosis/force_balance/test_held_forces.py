"""Forces that a computer holds from row to row: seen where little else is missing, and asked again beside what was."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.force_balance import procedure
from mpge_jax.diagnosis.force_balance.procedure import PLAIN
from mpge_jax.diagnosis.force_balance.resolution import choose
from tests.diagnosis.machines import ARM

MOTORS = ARM.replace(
    '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>',
    '<motor name="elbow_motor" joint="elbow"/>',
)
LOADED = MOTORS.replace(
    "</body></body></worldbody>",
    '<body pos=".08 0 -.25"><geom type="sphere" size=".01" mass="1.5" contype="0" conaffinity="0"/></body>'
    "</body></body></worldbody>",
)
PERIOD, STEPS = 0.01, 20
IDS = ("coulomb_friction", "viscous_damping", "armature", "sensor_delay", "payload_mass")


def recorded(xml: str) -> list[Recording]:
    """Three runs and a held-out one under a controller that computes its torques at the rows."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.option.timestep = PERIOD / STEPS
    model, out, rng = spec.compile(), [], np.random.default_rng(3)
    for name in ("run_0", "run_1", "run_2", "heldout_0"):
        data, rows = mujoco.MjData(model), []
        w, size = rng.uniform(2.0, 6.0, (3, 2)), rng.uniform(0.1, 0.3, (3, 2))
        phase = rng.uniform(0.0, 6.0, (3, 2))
        for k in range(400):
            angle = k * PERIOD * w + phase
            q, v = (size * np.sin(angle)).sum(0), (size * w * np.cos(angle)).sum(0)
            torque = data.qfrc_bias + [6.0, 2.0] * (q - data.qpos) + [1.2, 0.3] * (v - data.qvel)
            rows.append((k * PERIOD, data.qpos.copy(), data.qvel.copy(), torque))
            data.ctrl[:] = torque
            mujoco.mj_step(model, data, STEPS)
        time, q, v, torque = (np.array(x) for x in zip(*rows, strict=True))
        noisy = q + 1e-5 * rng.standard_normal(q.shape), v + 1e-3 * rng.standard_normal(v.shape)
        out.append(Recording(name, time, *noisy, None, torque + 0.02 * rng.standard_normal(torque.shape)))
    return out


@pytest.mark.parametrize("xml", [MOTORS, LOADED], ids=["nothing missing", "a load missing"])
def test_forces_that_are_held_are_no_late_encoders(xml):
    p = prepare(mujoco.MjSpec.from_string(MOTORS), recorded(xml), Config(jobs=1, effects=IDS))
    plain = all_terms(p.ctx, PLAIN)
    # what the load does hides it
    assert choose(p, plain, {}).held == (xml is MOTORS)
    found = procedure.decide(p, lambda _: None)
    assert found.balance.resolution.held
    assert {t.id for t in found.parts if t.effect.named} == (set() if xml is MOTORS else {"payload_mass"})
