"""Steps finer than the model's show once the physics that hid them is known, with masses near the given ones."""

from types import SimpleNamespace

import mujoco
import pytest

from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.measurement.finer_steps import in_steps_as_seen
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import fitted, search_of

STIFF = ARM.replace('kp="8" kv="0.4"', 'kp="40" kv="1"').replace('"0.005"', '"0.004"')


def _loaded(model: mujoco.MjModel) -> None:
    """0.2 kg at the fore arm, and masses that are off by a few per cent."""
    model.body_mass[1:] *= [1.04, 0.96]
    model.body_inertia[1:] *= [[0.96], [1.04]]
    body = model.body("fore").id
    model.body_mass[body] += 0.2


@pytest.fixture(scope="module")
def loaded():
    s, p = search_of(STIFF, record(STIFF, [4.0, 0.8], change=_loaded, noise=1e-5))
    (load,) = (t for t in s.terms if str(t) == "payload_mass@fore")
    start = fitted(s, {load: load.effect.starts(p.ctx, load.place)[0]})
    return p, fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=12)[0]


def test_they_are_hidden_by_what_is_missing_and_show_beside_it(loaded):
    p, f = loaded
    model = MeasurementModel.without_physics(p, {})
    assert in_steps_as_seen(p) is p
    finer = model.with_moved_steps(SimpleNamespace(fit=f))
    assert finer.read().dt == p.dt / 4 and finer.read().timestep == p.timestep
    # and not finer still
    assert finer.with_moved_steps(SimpleNamespace(fit=f)) is None
