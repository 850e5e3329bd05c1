"""Machines that lack something in every joint, and machines that do not."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import mpge_jax.diagnosis.selection.forward_selection as searching
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.scored import Reached, Scored
from mpge_jax.diagnosis.recordings.recording import rows_of
from mpge_jax.diagnosis.selection import all_joints
from mpge_jax.diagnosis.selection.all_joints import everywhere
from mpge_jax.diagnosis.selection.competition import at_noise
from tests.diagnosis.machines import ARM, FINE_ARM, PENDULUM, really_sticks, record
from tests.diagnosis.searches import ARMATURE, COULOMB, GAIN, fitted, search_of

FRICTION, ROTOR = np.array([0.25, 0.12]), np.array([0.03, 0.02])


def _search(change):
    return search_of(ARM, record(ARM, [4.0, 0.8], change=change, count=4))[0]


def _fitted(s, theta: dict[str, float]) -> Fitted:
    parts = {t: np.array([theta[str(t)]]) for t in s.terms if str(t) in theta}
    h = Hypothesis.of(*parts)
    values = h.gather(s.sim.ctx, parts)
    return Fitted(h, values, values)


@pytest.mark.parametrize("load", [0.0, 0.25])
def test_friction_and_rotor_inertia_in_every_joint_are_found_together_and_a_load(load):
    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        model.dof_frictionloss[:] = FRICTION
        model.dof_armature[:] += ROTOR
        model.body_mass[2] += load

    s = _search(change)
    # what a forward search may begin with: a delay that stands for friction and inertia
    found = everywhere(s, _fitted(s, {"actuator_delay@elbow_servo": 0.01}))
    parts = {str(t): float(x[0]) for t, x in found.hypothesis.split(s.sim.ctx, found.theta).items()}
    if load:
        # a search that adds one effect at a time takes it for something else until all of them are there
        assert parts.pop("payload_mass@fore") == pytest.approx(load, rel=0.15)
    expected = {"coulomb_friction@shoulder", "coulomb_friction@elbow", "armature@shoulder", "armature@elbow"}
    assert set(parts) == expected
    for joint, friction, rotor in zip(("shoulder", "elbow"), FRICTION, ROTOR, strict=True):
        assert parts[f"coulomb_friction@{joint}"] == pytest.approx(friction, rel=0.1)
        assert parts[f"armature@{joint}"] == pytest.approx(rotor, rel=0.15)


def test_damping_gives_way_to_dry_friction_and_drag():
    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        v = float(data.qvel[0])
        data.qfrc_applied[0] -= 0.03 * abs(v) * v

    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        model.dof_frictionloss[0] = 0.1

    s = search_of(PENDULUM, record(PENDULUM, 0.8, change=change, force=force))[0]
    one = _fitted(s, {"viscous_damping@hinge": 0.08})
    found = everywhere(s, one)
    # its drag may as well be that of the arm, whose centre moves by 0.15 m a radian
    parts = {str(t): float(x[0]) for t, x in found.hypothesis.split(s.sim.ctx, found.theta).items()}
    drag = parts.pop("quadratic_drag@hinge", None) or 0.15**3 * parts.pop("quadratic_drag@arm")
    assert drag == pytest.approx(0.03, rel=0.05)
    assert parts == {"coulomb_friction@hinge": pytest.approx(0.1, rel=0.05)}
    # at joints that no law was found at nothing is added
    assert all_joints._with_all_laws(s, _fitted(s, {"armature@hinge": 0.01})) is None


CRANE = """<mujoco><option timestep="0.002" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/><position kp="40" kv="2"/></default><worldbody>
<body><joint name="yaw" axis="0 0 1" damping="0.05"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass="1"/>
<body pos=".2 0 0"><joint name="shoulder" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1"/>
<body pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="0.03"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025" mass=".6"/></body></body></body></worldbody>
<actuator><position joint="yaw"/><position joint="shoulder"/><position joint="elbow"/></actuator></mujoco>"""


def test_friction_and_rotor_inertia_in_every_joint_are_found_beside_masses_that_are_off():
    masses = np.array([0.95, 1.05, 0.94])

    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        model.dof_frictionloss[:] = 0.3, 0.25, 0.12
        model.dof_armature[:] += 0.04, 0.03, 0.02
        model.body_mass[1:] *= masses
        model.body_inertia[1:] *= (2.0 - masses)[:, None]

    s = search_of(CRANE, record(CRANE, [1.0, 0.8, 0.8], change=change, count=4))[0]
    found = everywhere(s, _fitted(s, {"armature@elbow": 0.01}))
    parts = found.hypothesis.split(s.sim.ctx, found.theta)
    (factors,) = (parts.pop(t) for t in list(parts) if not t.effect.named)
    assert factors[4] == pytest.approx(masses[2], abs=0.03)
    # of all that has a name, what is missing alone
    assert {t.id for t in parts} == {"coulomb_friction", "armature"} and len(parts) == 6


@pytest.mark.parametrize(
    ("effect", "size"),
    [
        pytest.param("actuator_delay", 0.03, marks=pytest.mark.slow),
        ("actuator_lag", 0.06),
        ("actuator_gain", 0.6),
    ],
)
def test_what_all_drives_have_in_common_is_found_together(effect, size):
    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        if effect == "actuator_gain":
            model.actuator_gainprm[:] *= size
            model.actuator_biasprm[:] *= size
        model.dof_frictionloss[:] = FRICTION

    obeyed = np.zeros(2)

    def lags(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        obeyed[:] = (
            data.ctrl if data.time == 0.0 else obeyed + (data.ctrl - obeyed) * model.opt.timestep / size
        )
        data.ctrl[:] = obeyed

    late = round(100 * size) if effect == "actuator_delay" else 0
    force = lags if effect == "actuator_lag" else None
    recordings = record(FINE_ARM, [4.0, 0.8], change=change, force=force, count=4)
    recordings = [replace(r, ctrl=np.roll(r.known("ctrl"), -late, axis=0)) for r in recordings]
    recordings = [rows_of(r, slice(0, r.time.size - late), r.name) for r in recordings]
    s = search_of(FINE_ARM, recordings)[0]
    found = everywhere(s, _fitted(s, {"coulomb_friction@shoulder": float(FRICTION[0])}))
    parts = {str(t): float(x[0]) for t, x in found.hypothesis.split(s.sim.ctx, found.theta).items()}
    drives = [f"{effect}@shoulder_motor", f"{effect}@elbow_servo"]
    assert set(parts) == {"coulomb_friction@shoulder", "coulomb_friction@elbow", *drives}
    np.testing.assert_allclose([parts[d] for d in drives], size, rtol=0.1)


def test_what_is_in_one_joint_is_not_sought_in_all():
    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        model.dof_frictionloss[0] = FRICTION[0]
        model.body_mass[:] *= 1.5
        model.body_inertia[:] *= 1.5

    s = _search(change)
    one = _fitted(s, {"coulomb_friction@shoulder": float(FRICTION[0])})
    assert not at_noise(s, one, s.whiten_one(one, s.train))
    # two weaker drives explain most of it, and one factor of all masses all of it
    drives = {t for t in everywhere(s, one).hypothesis.terms if t.id == "actuator_gain"}
    assert len(drives) == 2
    more = searching._everywhere_or_one_more(s, one)
    assert len(more.hypothesis.terms) == 2 and not drives & set(more.hypothesis.terms)
    assert {t.place.name for t in more.hypothesis.terms} == {"shoulder", "world"}
    # beside it, all joints may explain more: they are looked at again
    assert not s.looked


def test_all_joints_are_looked_at_once_before_a_search_ends(monkeypatch):
    s, kept = _search(really_sticks), []
    monkeypatch.setattr(s, "keep", kept.append)
    one = _fitted(s, {"coulomb_friction@elbow": 0.1})
    more = _fitted(s, {"coulomb_friction@elbow": 0.1, "armature@elbow": 0.01, "armature@shoulder": 0.01})
    looks: list[Fitted] = []

    def look(s, current):
        looks.append(current)
        s.looked = True
        return more

    monkeypatch.setattr(searching, "everywhere", look)
    s.resume, nothing = Reached(one), np.zeros(0)
    monkeypatch.setattr(searching, "compete", lambda _s, f, _terms: ([], Scored(f, nothing, nothing, 0, 0)))
    assert searching.search(s) == (more, [])
    assert looks == [one]
    assert [r.fit for r in kept] == [more]


def test_what_is_weak_by_itself_stays_where_all_of_it_is_needed(monkeypatch):
    """No term shows beyond doubt; without any of four, windows are predicted worse, and without others not."""

    def change(model: mujoco.MjModel) -> None:
        really_sticks(model)
        model.dof_frictionloss[:] = FRICTION
        model.dof_armature[:] += ROTOR

    s = _search(change)
    plain = {"coulomb_friction@shoulder": 0.25, "coulomb_friction@elbow": 0.12}
    f = _fitted(s, {**plain, "armature@shoulder": 0.03, "armature@elbow": 0.02})
    own = all_joints.strength
    monkeypatch.setattr(all_joints, "strength", lambda s, f: {t: 1e-6 * z for t, z in own(s, f).items()})
    assert set(map(str, all_joints._thinned(s, f).hypothesis.terms)) == set(map(str, f.hypothesis.terms))
    more = _fitted(
        s, {**plain, "armature@shoulder": 0.03, "armature@elbow": 0.02, "viscous_damping@elbow": 1e-4}
    )
    assert set(all_joints._thinned(s, more).hypothesis.terms) == set(f.hypothesis.terms)


def test_what_forces_say_is_enough_where_it_leaves_only_noise(rubbing, monkeypatch):
    s, _ = rubbing
    said = fitted(s, {COULOMB: [0.07], GAIN: [1.0]})
    s = replace(s, by_forces=lambda: said, terms=[t for t in s.terms if t != GAIN], log=[])
    monkeypatch.setattr(all_joints, "_together", lambda *_: pytest.fail("asked for more"))
    found = everywhere(s, NOTHING)
    # it is fitted to the motion, without what is no candidate
    assert found.hypothesis.terms == (COULOMB,) and found.theta[0] == pytest.approx(0.1, rel=0.05)
    wrong = replace(s, by_forces=lambda: fitted(s, {ARMATURE: [0.05]}), log=[])
    monkeypatch.setattr(all_joints, "_together", lambda *_: [])
    assert everywhere(wrong, NOTHING) is NOTHING
