"""Windows: what actuators' filters hold where one starts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from machines import PENDULUM

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.model import compile_variable, names_of
from mpge_jax.diagnosis.prepare import prepare
from mpge_jax.diagnosis.recording import validate

FILTER = PENDULUM.replace("<motor", '<general dyntype="filterexact" dynprm=".03"')
MUSCLE = PENDULUM.replace("<motor", '<muscle lengthrange="-2 2" timeconst=".02 .05" force="3"')
MUSCLE = MUSCLE.replace('ctrlrange="-2 2"', 'ctrlrange="0 1"')
RATE = 100


def _record(xml: str, runs: int = 3) -> tuple[list[Recording], list[np.ndarray]]:
    """Recordings that begin with empty filters, and the activations along them."""
    out, activations = [], []
    rng = np.random.default_rng(0)
    for k in range(runs):
        model = mujoco.MjModel.from_xml_string(xml)
        data, rows, act = mujoco.MjData(model), [], []
        for i in range(2 * RATE):
            u = 0.5 + 0.4 * np.sign(np.sin(0.13 * i + k))
            rows.append((i / RATE, data.qpos[0], u))
            act.append(data.act[0])
            data.ctrl[0] = u
            mujoco.mj_step(model, data, round(1 / RATE / model.opt.timestep))
        t, q, u = np.array(rows).T
        q = q + 1e-5 * rng.standard_normal(q.size)
        out.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None]))
        activations.append(np.array(act))
    return out, activations


@pytest.mark.parametrize(("xml", "settling"), [(FILTER, 0.15), (MUSCLE, 0.25)])
def test_windows_start_with_the_activation_that_the_commands_left(xml, settling):
    recordings, activations = _record(xml)
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    w = p.windows(False, 0.25, 40)
    assert w.start.min() >= settling
    names = {r.name: a for r, a in zip(recordings, activations, strict=True)}
    for source, start, act in zip(w.source, w.start, w.act0[:, 0], strict=True):
        true = names[w.sources[source].recording.name][round(start * RATE)]
        # at the start the filter was taken for settled: e^-5 of the command
        assert act == pytest.approx(true, abs=0.01)


def test_what_a_filter_held_before_the_recording_is_no_physics():
    d = diagnose(mujoco.MjSpec.from_string(FILTER), _record(FILTER)[0], Config(jobs=1))
    assert d.verdict == "none"
