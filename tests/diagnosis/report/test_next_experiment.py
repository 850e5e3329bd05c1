"""The proposed experiment separates what the recordings could not, and keeps joints inside their limits."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import whitener
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.report.next_experiment import command_range, design

TURNTABLE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="table">
<joint name="pivot" axis="0 0 1" damping="0.05"/>
<geom type="cylinder" size=".1 .01" mass="2" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="pivot" ctrlrange="-0.6 0.6" ctrllimited="true"/></actuator></mujoco>"""
FRICTION, NOISE = 0.08, 1e-4


def _changed(bias: float = 0.0, friction: float = 0.0) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(TURNTABLE)
    spec.joints[0].frictionloss = friction
    spec.actuators[0].biastype = mujoco.mjtBias.mjBIAS_AFFINE
    prm = np.array(spec.actuators[0].biasprm)
    prm[0] = bias
    spec.actuators[0].biasprm = prm
    return spec.compile()


def _forward_only(k: int) -> Recording:
    """A turntable with dry friction that never turns back."""
    model, rng = _changed(friction=FRICTION), np.random.default_rng(k)
    data = mujoco.MjData(model)
    data.qvel[:] = 3.0
    time, rows, commands = 0.01 * np.arange(151), [], []
    for t in time:
        rows.append(data.qpos.copy())
        commands.append([0.3 + 0.15 * np.sin(5.0 * t + k)])
        data.ctrl[:] = commands[-1]
        mujoco.mj_step(model, data, 5)
    qpos = np.array(rows) + NOISE * rng.standard_normal((151, 1))
    return Recording(f"run_{k}", time, qpos, None, np.array(commands))


@pytest.fixture(scope="module")
def ambiguous() -> tuple[SimpleNamespace, dict[Term, list[Fitted]]]:
    """Coulomb friction and a constant actuator bias, both fitted to forward motion."""
    spec = mujoco.MjSpec.from_string(TURNTABLE)
    model = compile_variable(spec)
    recordings = [validate(_forward_only(k), model, names_of(model)) for k in range(3)]
    config = Config(jobs=1, quiet=True)
    p = prepare(spec, recordings, config)
    w = p.windows("train", 0.25, 12)
    white = whitener(p.sim, Hypothesis(), np.zeros(0), w, p.noise)
    terms = [Term(i, REGISTRY[i].places(p.ctx)[0]) for i in ("coulomb_friction", "actuator_bias")]
    starts = [Fitted(Hypothesis.of(t), t.effect.starts(p.ctx, t.place)[0], np.zeros(1)) for t in terms]
    return SimpleNamespace(prepared=p, config=config), {terms[0]: fit(p.sim, starts, w, white)}


def _replay(model: mujoco.MjModel, file: dict[str, np.ndarray]) -> np.ndarray:
    data, out = mujoco.MjData(model), []
    data.qpos[:] = file["qpos0"]
    for u in file["ctrl"]:
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        out.append(float(data.qpos[0]))
    return np.array(out)


@pytest.mark.parametrize("limit", [None, 1.0], ids=["free", "limited"])
def test_commands_turn_back_and_separate_friction_from_bias(tmp_path, ambiguous, limit):
    d, groups = ambiguous
    d.prepared.model.jnt_limited[0] = limit is not None
    d.prepared.model.jnt_range[0] = (-limit, limit) if limit is not None else (0.0, 0.0)
    (fits,) = groups.values()
    friction, bias = (float(f.theta[0]) for f in fits)
    assert friction == pytest.approx(FRICTION, rel=0.1) and bias == pytest.approx(-FRICTION, rel=0.1)
    path = tmp_path / "next_experiment.npz"
    found = design(d, groups, path)
    assert found is not None and found["separation"] > 5
    assert [x.name for x in tmp_path.iterdir()] == ["next_experiment.npz"]
    with np.load(path) as archive:
        file = dict(archive)
    assert (np.abs(file["ctrl"]) <= 0.6 + 1e-9).all() and file["ctrl"].min() < 0
    true = _replay(_changed(friction=friction), file)
    gaps = [
        float(np.sqrt(np.mean((_replay(_changed(bias=b), file) - true) ** 2)))
        for b in bias + 0.01 * np.arange(-8, 9)
    ]
    assert min(gaps) > 5 * NOISE
    # about as far and as fast as the machine was seen to move
    seen = np.concatenate([x.states.qpos[:, 0] for x in d.prepared.train])
    fastest = max(np.abs(x.states.qvel).max() for x in d.prepared.train)
    spare = 0.55 * np.ptp(seen)
    assert seen.min() - spare < true.min() and true.max() < seen.max() + spare
    assert np.abs(np.diff(true)).max() / d.prepared.dt < 2.1 * fastest
    if limit is not None:
        assert np.abs(true).max() < limit
        assert np.abs(_replay(_changed(bias=bias), file)).max() < limit


def test_range_is_the_models_or_reaches_both_ways():
    unlimited = TURNTABLE.replace('ctrlrange="-0.6 0.6" ctrllimited="true"', "")
    for xml, expected in ((TURNTABLE, 0.6), (unlimited, 0.45)):
        model = compile_variable(mujoco.MjSpec.from_string(xml))
        source = SimpleNamespace(command=np.linspace(0.15, 0.45, 9)[:, None])
        d = SimpleNamespace(prepared=SimpleNamespace(model=model, train=(source,)))
        low, high = command_range(d)
        np.testing.assert_allclose([low[0], high[0]], [-expected, expected], rtol=1e-5)


def test_the_whole_diagnosis_says_that_forward_motion_cannot_tell_friction_from_bias(plain_functions):
    spec = mujoco.MjSpec.from_string(TURNTABLE)
    # among what else slows a turntable down; the rest of the vocabulary only takes time
    effects = ("coulomb_friction", "actuator_bias", "external_force", "viscous_damping", "actuator_gain")
    config = Config(jobs=1, quiet=True, effects=effects)
    found = diagnose(spec, [_forward_only(k) for k in range(4)], config).to_json()
    assert found["verdict"] == "ambiguous"
    (group,) = found["ambiguous"]
    candidates = {effect["id"] for effects in group["candidates"] for effect in effects}
    assert {"coulomb_friction", "actuator_bias"} <= candidates
