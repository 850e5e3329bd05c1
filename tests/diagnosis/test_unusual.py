"""Models and recordings that are legitimate, but unlike most."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, InputError, Recording, diagnose
from mpge_jax.diagnosis.corrected.mjcf import _text
from mpge_jax.diagnosis.dataset.cut_windows import _spans
from mpge_jax.diagnosis.drives.command_to_force import diagnose_actuators
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.evidence.rigid_equivalence import name_nearest, one_of_each, same_body
from mpge_jax.diagnosis.machine.contact_pairs import allowed_pairs
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.checks import check_base
from mpge_jax.diagnosis.recordings.reader import read_recording
from mpge_jax.diagnosis.recordings.rows.late_rows import READ_SO
from mpge_jax.diagnosis.simulation.driving.measured_drives import drive_by_force
from tests.diagnosis.machines import ARM, BOX, PENDULUM, record
from tests.diagnosis.searches import MISTAKEN_FOR_FRICTION, prepared_of


def _log(time: np.ndarray) -> Recording:
    return Recording("run", time, np.sin(time)[:, None], None, np.zeros((time.size, 1)))


def test_windows_go_on_after_lost_rows():
    time = np.delete(np.arange(0, 20, 0.02), [24, 25, 26, 500, 501])
    spans = _spans(_log(time), 0.25)
    assert len(spans) > 70
    assert all(time[b] - time[a] >= 0.2 for a, b in spans)


@pytest.mark.parametrize("rate", [5, 7, 10, 11, 15.5])
def test_sparse_rows_hold_windows_of_whole_steps(rate):
    time = np.arange(0, 20, 1 / rate)
    p = prepared_of(PENDULUM, [dataclasses.replace(_log(time + k), name=f"run_{k}") for k in range(3)])
    w = p.windows("train", 0.25, 1000)
    assert w.count > 60
    assert (w.times.max(1) >= 0.2).all() and (w.times.max(1) < 0.45).all()


@pytest.mark.parametrize("change", [("<motor", '<general dyntype="filterexact" dynprm=".05"'), None])
def test_forces_of_actuators_with_a_state_are_not_judged_by_their_commands(change):
    xml = (
        PENDULUM.replace(*change)
        if change
        else PENDULUM.replace("ctrlrange", 'delay=".02" nsample="20" ctrlrange')
    )
    recordings = [dataclasses.replace(r, force=0.3 * r.ctrl) for r in record(PENDULUM, 0.8)]
    p = prepared_of(xml, recordings)
    found = diagnose_actuators(
        p, compile_variable(mujoco.MjSpec.from_string(xml)), ["actuator_gain", "actuator_lag"]
    )
    assert found is not None and not found.fits
    assert any("motor turns commands into force is not checked" in w for w in p.warnings)


def test_neither_commands_nor_forces_is_refused():
    recordings = record(PENDULUM, 0.8)
    recordings[1] = dataclasses.replace(recordings[1], ctrl=None, force=recordings[1].ctrl)
    with pytest.raises(InputError, match="run_1 holds no commands, and the force of motor was not measured"):
        prepared_of(PENDULUM, recordings)


def test_forces_that_some_recordings_lack_are_not_used():
    recordings = [dataclasses.replace(r, force=0.3 * r.ctrl) for r in record(PENDULUM, 0.8)]
    recordings[1] = dataclasses.replace(recordings[1], force=None)
    p = prepared_of(PENDULUM, recordings)
    assert not p.measured.any()
    assert any("force of motor was not measured in most rows" in w for w in p.warnings)


def _transitions(friction: float, count: int = 150, noise: float = 1e-4) -> list[Recording]:
    """Recordings of two rows each, from states and commands that have nothing to do with each other."""
    rng, out = np.random.default_rng(0), []
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.dof_frictionloss[0] = friction
    model.opt.timestep = 0.001
    for k in range(count):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0], data.ctrl[0] = (
            rng.uniform(-2, 2),
            rng.normal(0, 2),
            rng.uniform(-1.5, 1.5),
        )
        rows = [(data.qpos.copy(), data.qvel.copy())]
        mujoco.mj_step(model, data, 20)
        rows.append((data.qpos.copy(), data.qvel.copy()))
        q, v = (np.array(x) for x in zip(*rows, strict=True))
        q, v = q + noise * rng.standard_normal((2, 1)), v + 10 * noise * rng.standard_normal((2, 1))
        out.append(Recording(f"transition_{k}", np.array([0.0, 0.02]), q, v, np.full((2, 1), data.ctrl[0])))
    return out


def test_single_transitions_are_recordings(plain_functions):
    spec = mujoco.MjSpec.from_string(PENDULUM)
    config = Config(jobs=1, effects=("coulomb_friction", *MISTAKEN_FOR_FRICTION))
    assert diagnose(spec, _transitions(0.0), config).verdict == "none"
    d = diagnose(spec, _transitions(0.15), config)
    assert [(t.name, t.place.name) for t in d.terms] == [("coulomb_friction", "hinge")]
    assert d.fit.theta[0] == pytest.approx(0.15, rel=0.05)


GANTRY = """<mujoco><worldbody><body name="tool"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="y" type="slide" axis="0 1 0"/><joint name="z" type="slide" axis="0 0 1"/><geom size=".1"/></body>
</worldbody><actuator><motor name="mx" joint="x"/></actuator></mujoco>"""


HUNG = GANTRY[: GANTRY.index("<actuator>")] + "</mujoco>"


@pytest.mark.parametrize(
    ("xml", "places"),
    [
        (GANTRY, ["x", "y", "z"]),
        (HUNG, []),
        *(
            (HUNG.replace('axis="0 1 0"', f'axis="0 1 0" {x}="2"'), ["x", "y", "z"])
            for x in ("stiffness", "damping")
        ),
        (HUNG.replace('axis="0 1 0"', 'axis="0 1 0" frictionloss="2"'), ["x", "y", "z"]),
        (HUNG.replace('axis="0 1 0"', 'axis="0 1 0" armature="2"'), []),
    ],
)
def test_joints_of_a_root_body_that_are_driven_or_sprung_are_no_floating_base(xml, places):
    """A washing machine's tub moves along three joints of one body, on springs and dampers that rub."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    assert [p.name for p in REGISTRY["coulomb_friction"].places(ctx)] == places


def test_commands_are_not_clipped_where_the_model_says_so():
    xml = PENDULUM.replace("<worldbody>", '<option><flag clampctrl="disable"/></option><worldbody>')
    model = compile_variable(load_spec(mujoco.MjSpec.from_string(xml)))
    assert not model.actuator_ctrllimited.any()
    recordings = record(PENDULUM, 3.0)
    assert any("leave its ctrlrange" in w for w in prepared_of(PENDULUM, recordings).warnings)
    assert not any("leave its ctrlrange" in w for w in prepared_of(xml, recordings).warnings)


def test_equal_names_are_refused_and_copies_warned_of():
    recordings = record(PENDULUM, 0.8)
    with pytest.raises(InputError, match="4 recordings are called 'run'"):
        diagnose(
            mujoco.MjSpec.from_string(PENDULUM), [dataclasses.replace(r, name="run") for r in recordings]
        )
    copy = dataclasses.replace(recordings[0], name="heldout_0")
    assert any("same recording" in w for w in prepared_of(PENDULUM, [*recordings, copy]).warnings)


def test_what_holds_for_several_recordings_is_said_once():
    def told(count: int, clipped: int) -> list[str]:
        """Warnings of recordings of an arm whose elbow stands still, the first `clipped` with a command too large."""
        runs = record(ARM, [1.0, 0.2], count=count)
        for k, r in enumerate(runs):
            r.qpos[:, 1] = 0.1
            r.ctrl[:, 0] = 9.0 if k < clipped else 1.0
        xml = ARM.replace('joint="shoulder"/>', 'joint="shoulder" ctrllimited="true" ctrlrange="-3 3"/>')
        return [w for w in prepared_of(xml, runs).warnings if "never moved" in w or "ctrlrange" in w]

    still = "every recording: elbow never moved; what acts there cannot be seen here."
    clipped = "commands of shoulder_motor leave its ctrlrange and are clipped."
    assert told(3, 0) == [still]
    assert set(told(3, 2)) == {still, f"run_0, run_1: {clipped}"}
    assert set(told(6, 5)) == {still, f"run_0, run_1, run_2 and 2 others: {clipped}"}


def test_a_machine_at_rest_never_moved_whatever_its_noise():
    rng, time = np.random.default_rng(0), np.arange(300) / 100
    still = [
        Recording(f"run_{k}", time, 1e-4 * rng.standard_normal((300, 1)), None, np.zeros((300, 1)))
        for k in range(3)
    ]
    with pytest.raises(InputError, match="the robot never moved in any recording"):
        prepared_of(PENDULUM, still)
    assert not any("never moved" in w for w in prepared_of(PENDULUM, record(PENDULUM, 0.8)).warnings)


@pytest.mark.parametrize(("unit", "scale"), [("degrees", 180 / np.pi), ("ticks", 4096 / (2 * np.pi))])
def test_positions_that_cannot_be_radians_are_refused(unit, scale):
    runs = [replace(r, qpos=scale * r.qpos) for r in record(PENDULUM, 0.3)]
    with pytest.raises(InputError, match=r"positions of hinge reach .* cannot be radians.*unit: deg"):
        prepared_of(PENDULUM, runs)


def test_a_wheel_that_turns_far_is_believed():
    wheel = PENDULUM.replace("<option ", '<option gravity="0 0 0" ').replace(
        'damping="0.02"', 'damping="0.001"'
    )
    time, out = np.arange(400) / 100, []
    for k in range(3):
        model = mujoco.MjModel.from_xml_string(wheel)
        data, rows = mujoco.MjData(model), []
        for i in range(400):
            data.ctrl[0] = 0.3 + 0.1 * np.sin(0.05 * i + k)
            rows.append((data.qpos.copy(), data.ctrl.copy()))
            for _ in range(5):
                mujoco.mj_step(model, data)
        q, u = (np.array(x) for x in zip(*rows, strict=True))
        out.append(Recording(f"run_{k}", time, q, None, u))
    assert out[0].qpos.max() > 20.0
    assert not any("degrees" in w for w in prepared_of(wheel, out).warnings if "cannot" in w)


def test_rows_that_hold_the_command_of_the_row_before_are_read_as_they_were_meant():
    right = record(PENDULUM, 0.3)
    late = [replace(r, ctrl=np.concatenate([r.ctrl[:1], r.ctrl[:-1]])) for r in right]
    p = prepared_of(PENDULUM, late)
    assert p.warnings[0] == READ_SO
    shown = p.train[0].recording
    (same,) = (r for r in right if r.name == shown.name)
    np.testing.assert_array_equal(shown.ctrl[:-1], same.ctrl[: shown.time.size - 1])
    # a command that acts a row late may be the machine's delay, and stays
    early = [replace(r, ctrl=np.concatenate([r.ctrl[1:], r.ctrl[-1:]])) for r in right]
    for runs in (right, early):
        assert READ_SO not in prepared_of(PENDULUM, runs).warnings


def test_commands_for_a_model_without_actuators_are_refused(tmp_path):
    plain = compile_variable(
        mujoco.MjSpec.from_string(PENDULUM[: PENDULUM.index("<actuator>")] + "</mujoco>")
    )
    time = np.arange(50) / 100
    np.savez(tmp_path / "run.npz", time=time, qpos=np.sin(time)[:, None], ctrl=np.ones((50, 1)))
    with pytest.raises(
        InputError, match=r"run holds commands .*no actuators .*Leave that column out only if"
    ):
        read_recording(tmp_path / "run.npz", plain, names_of(plain))
    np.savez(tmp_path / "run.npz", time=time, qpos=np.sin(time)[:, None], ctrl=np.zeros((50, 1)))
    assert read_recording(tmp_path / "run.npz", plain, names_of(plain)).ctrl is None


def test_disabled_forces_are_said():
    xml = PENDULUM.replace("/><worldbody>", '><flag frictionloss="disable"/></option><worldbody>')
    assert any("disables frictionloss" in w for w in prepared_of(xml, record(PENDULUM, 0.8)).warnings)


def test_unnamed_actuators_of_one_joint_have_names_of_their_own():
    xml = PENDULUM.replace("</actuator>", '<position joint="hinge"/><velocity joint="hinge"/></actuator>')
    assert names_of(mujoco.MjModel.from_xml_string(xml)).actuators == ("motor", "hinge", "actuator_2")


def test_contacts_with_a_direct_stiffness_have_no_time_constant():
    direct = BOX.replace('mass="1"', 'mass="1" solref="-5000 -60"')
    for xml, places in ((BOX, ["world"]), (direct, [])):
        ctx = nominal_context(mujoco.MjModel.from_xml_string(xml))
        assert ctx.contacts == allowed_pairs(ctx.model) != ()
        assert [q.name for q in REGISTRY["contact_stiffness"].places(ctx)] == places


@pytest.mark.parametrize("encoding", ["gbk", "nonsense"])
def test_unreadable_encodings_are_named(tmp_path, encoding):
    path = tmp_path / "m.xml"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?>' + PENDULUM)
    with pytest.raises(InputError, match="save it as UTF-8"):
        load_spec(path)


def test_pictures_of_cubes_are_copied(tmp_path):
    (tmp_path / "tex").mkdir()
    for side in ("a", "b"):
        plt.imsave(tmp_path / "tex" / f"{side}.png", np.zeros((2, 2, 3)))
    faces = ("right", "left", "up", "down", "front", "back")
    sides = " ".join(f'file{face}="{"ab"[i % 2]}.png"' for i, face in enumerate(faces))
    asset = f'<asset><texture name="t" type="cube" {sides}/></asset><worldbody>'
    path = tmp_path / "m.xml"
    path.write_text(
        PENDULUM.replace("<worldbody>", asset).replace("<mujoco>", '<mujoco><compiler texturedir="tex"/>')
    )
    spec = load_spec(path)
    spec.compile()
    out = tmp_path / "out"
    out.mkdir()
    (out / "nominal.xml").write_text(_text(spec, out))
    assert sorted(f.name for f in (out / "assets").iterdir()) == ["a.png", "b.png"]
    assert mujoco.MjModel.from_xml_path(str(out / "nominal.xml")).ntex == 1


def test_a_delay_in_the_model_is_filled_with_the_commands_before_a_window():
    """Nothing is missing: the truth has the model's delay of 30 ms; 10 ms more are exported on top of it."""
    xml = PENDULUM.replace("ctrlrange", 'delay="0.03" nsample="64" ctrlrange')
    p = prepared_of(xml, record(xml, 0.8))
    w = p.windows("train", 0.25, 40)
    nothing = errors(p.sim, NOTHING, w, p.noise)
    plain = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    assert nothing.rms < 1.5 * errors(plain.sim, NOTHING, plain.windows("train", 0.25, 40), plain.noise).rms
    spec = mujoco.MjSpec.from_string(xml)
    assert REGISTRY["actuator_delay"].export(spec, p.ctx, Place("actuator", "motor", 0), np.array([0.01]))
    assert spec.compile().actuator_delay[0] == pytest.approx(0.04)


def test_forces_may_drive_what_had_a_state_and_a_keyframe():
    xml = PENDULUM.replace("<motor", '<intvelocity kp="5" actrange="-1 1"')
    xml = xml.replace("</mujoco>", '<keyframe><key name="home" qpos="0.1" act="0.2"/></keyframe></mujoco>')
    model = compile_variable(drive_by_force(mujoco.MjSpec.from_string(xml), np.array([True])))
    assert model.na == 0 and model.actuator_gainprm[0, 0] == 1.0


def test_actuators_with_several_inputs_are_refused():
    xml = PENDULUM.replace("<motor", '<pid kp="5"').replace('ctrlrange="-2 2" ctrllimited="true"', "")
    with pytest.raises(InputError, match="several inputs or outputs"):
        compile_variable(mujoco.MjSpec.from_string(xml))


@pytest.mark.parametrize(
    "xml", [PENDULUM, PENDULUM.replace("<motor", '<general dyntype="filterexact" dynprm=".03"')]
)
@pytest.mark.parametrize("size", [0.0, 1.2])
def test_drives_have_a_size_whatever_they_are_told(xml, size):
    """A bias shows best where the command is zero."""
    bias = 0.3
    p = prepared_of(xml, record(PENDULUM, size, force=lambda _, data: data.qfrc_applied.__setitem__(0, bias)))
    effect = REGISTRY["actuator_bias"]
    (param,) = effect.params(p.ctx, effect.places(p.ctx)[0])
    assert bias < param.high < 1000 * bias and param.scale < bias


REACHER = """<mujoco><worldbody><body name="link"><joint name="j" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5" contype="0" conaffinity="0"/>
<body name="hand" pos=".3 0 0" euler="0 90 0">
<geom type="box" size=".02 .02 .05" mass=".2" contype="0" conaffinity="0"/>
</body></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""


def test_a_mass_on_a_rigid_body_is_named_once_and_at_the_nearest_part():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(REACHER)))
    link, hand = (Term("payload_mass", p) for p in REGISTRY["payload_mass"].places(ctx))
    assert same_body(ctx, link, hand) and not same_body(ctx, link, Term("com_offset", hand.place))
    bias = Term("actuator_bias", REGISTRY["actuator_bias"].places(ctx)[0])
    h = Hypothesis.of(link, bias)
    cov = np.diag([1e-4, 1e-6, 4e-6, 9e-6, 25e-6])  # mass and position of the payload, then the bias
    order = [t.id for t in h.terms]
    parts = {link: np.array([0.1, 0.35, 0.02, 0.0]), bias: np.array([0.3])}
    theta = h.gather(ctx, parts)
    cov = cov if order[0] == "payload_mass" else np.diag([25e-6, 1e-4, 1e-6, 4e-6, 9e-6])
    f = name_nearest(ctx, Fitted(h, theta, theta.copy(), cov=cov))
    found = f.hypothesis.split(ctx, f.theta)
    # the hand's x axis points down, its z axis along the link
    np.testing.assert_allclose(found[hand], [0.1, 0.0, 0.02, 0.05], atol=1e-12)
    assert found[bias] == [0.3]
    part = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(hand)]
    np.testing.assert_allclose(np.diag(f.cov[part, part]), [1e-4, 9e-6, 4e-6, 1e-6], atol=1e-15)
    again = name_nearest(ctx, f)
    assert again is f
    # two masses on one rigid body both stay
    both = Hypothesis.of(link, hand)
    theta = both.gather(ctx, {link: np.array([0.1, 0.35, 0.0, 0.0]), hand: np.array([0.7, 0.0, 0.0, 0.1])})
    kept = name_nearest(ctx, Fitted(both, theta, theta.copy()))
    assert kept.hypothesis == both and (kept.theta == theta).all()
    alone = [Fitted(Hypothesis.of(t), np.zeros(4), np.zeros(4)) for t in (hand, link)]
    assert one_of_each(ctx, alone) == alone[:1]


def test_the_pose_of_a_base_must_be_measured_where_it_matters():
    xml = """<mujoco><worldbody><geom type="plane" size="5 5 1"/><body name="trunk" pos="0 0 .3">
    <freejoint name="root"/><geom type="box" size=".2 .1 .05"/><body pos=".2 0 0"><joint name="leg" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.24" size=".02"/></body></body></worldbody>
    <actuator><motor joint="leg"/></actuator></mujoco>"""
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    qpos = np.tile(model.qpos0, (20, 1))
    for columns, refused in (([0, 1], False), ([2], True), ([0, 1, 2, 3, 4, 5, 6], True)):
        seen = qpos.copy()
        seen[:, columns] = np.nan
        recordings = [Recording("run", 0.01 * np.arange(20), seen, None, np.zeros((20, 1)))]
        if refused:
            with pytest.raises(
                InputError, match=r"the pose of its base \('root'\), which was never measured"
            ):
                check_base(recordings, model, names_of(model))
        else:
            check_base(recordings, model, names_of(model))
