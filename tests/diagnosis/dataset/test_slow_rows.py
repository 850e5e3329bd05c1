"""Logs of 30 Hz whose commands are held between rows: starts are told with what these do, real ones and simulated."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence import null_distribution
from tests.diagnosis.machines import excitation
from tests.diagnosis.searches import prepared_of

ARM = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="8" kv="0.6"/></actuator></mujoco>"""
ROW, STEP = 0.032, 0.0005


@pytest.fixture(scope="module")
def slow() -> tuple[Prepared, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """A prepared arm, and times and true velocities of its recordings."""
    model, rng = mujoco.MjModel.from_xml_string(ARM), np.random.default_rng(0)
    model.opt.timestep = STEP
    recordings, true = [], {}
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        for i in range(150):
            data.ctrl[:] = u = excitation(k % 2 * 2, ROW * i, np.array([k]), np.array([0.8]))
            mujoco.mj_forward(model, data)
            rows.append((ROW * i, data.qpos.copy(), data.qvel.copy(), u))
            mujoco.mj_step(model, data, round(ROW / STEP))
        time, q, v, u = (np.array(x) for x in zip(*rows, strict=True))
        recordings.append(Recording(f"run_{k}", time, q + 5e-5 * rng.standard_normal(q.shape), None, u))
        true[f"run_{k}"] = time, v
    return prepared_of(ARM, recordings), true


def _error(w, true) -> float:
    """Rms of the windows' first velocities less the true ones."""
    each = []
    for source, start, v0 in zip(w.source, w.start, w.v0, strict=True):
        r = w.sources[source].recording
        time, v = true[r.log]
        each.append(v0 - v[np.argmin(np.abs(time - start - r.origin))])
    return float(np.sqrt(np.mean(np.square(each))))


@pytest.mark.parametrize("part", ["train", "test"])
def test_windows_start_with_the_velocities_that_commands_leave(slow, part):
    p, true = slow
    assert all(s.states.jumps.any() for s in p.sources)
    usual = np.sqrt(np.mean([np.mean(v**2) for _, v in true.values()]))
    # without them 0.06
    assert _error(p.windows(part, 0.5, 20), true) < 0.045 * usual


def test_simulated_recordings_are_smoothed_with_the_same_jumps(slow, monkeypatch):
    p, _ = slow
    own, told = null_distribution.smoothed, []

    def smoothed(segments, model, noise, jumps):
        told.extend(zip(segments, jumps, strict=True))
        return own(segments, model, noise, jumps)

    monkeypatch.setattr(null_distribution, "smoothed", smoothed)
    null_distribution.floor(p, NOTHING, 0.25)
    assert told and all(x.shape == (r.time.size, 1) for r, x in told)
    every = np.concatenate([s.states.jumps[:, 0] for s in p.train])
    for _, x in told:
        # a stretch of those of the recordings
        assert any(np.array_equal(every[k : k + len(x)], x[:, 0]) for k in np.flatnonzero(every == x[0, 0]))
