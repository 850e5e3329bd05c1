"""Corrections in the user's own files: compiled again, they have the corrected model's parameters."""

from __future__ import annotations

import shutil
import subprocess
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import yaml

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.corrected import patch
from mpge_jax.diagnosis.corrected.differences import differences
from mpge_jax.diagnosis.corrected.patch import patched
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec

MJCF = """<?xml version="1.0"?>
<!-- An arm of somebody's own: this remark and the layout stay. -->
<mujoco model="arm">
  <compiler angle="degree"/>
  <default><joint damping="0.05"/><motor ctrlrange="-2 2"/></default>
  <worldbody>
    <geom type="plane" size="3 3 1" name="floor"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" stiffness='0.3' springref="20"/>
      <frame pos="0 0 0.01"><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1"/></frame>
      <body pos="0 0 -.3">
        <joint axis="0 1 0" damping="0.03"
               frictionloss="0.01" />
        <inertial pos="0 0 -.1" mass="0.6" fullinertia="0.004 0.004 0.001 0 0.0005 0"/>
        <geom name="tip" type="sphere" size=".02" pos="0 0 -.25"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m" joint="shoulder"/>
    <position name="servo" joint="shoulder" kp="8" kv="0.4"/>
  </actuator>
</mujoco>
"""

URDF = """<?xml version="1.0"?>
<robot name="arm"><!-- kept -->
  <mujoco><compiler discardvisual="false"/></mujoco>
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0.01 -0.1" rpy="0.3 0 1.2"/>
      <mass value="1.5"/>
      <inertia ixx="0.02" iyy="0.025" izz="0.01" ixy="0.001" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tool">
    <inertial><mass value="0.4"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="fore"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
    <inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="10" velocity="9"/><dynamics damping="0.1"/></joint>
  <joint name="flange" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0.05 0 0.1" rpy="0 0 0.4"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 -0.3"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""  # noqa: E501


def models(path, effects):
    """The nominal and the corrected model of a file, and whether each effect is in the latter: [(id, place, theta)]."""
    spec = load_spec(path)
    nominal = spec.copy().compile()
    spec.compile()
    ctx = nominal_context(compile_variable(load_spec(path)))
    native = {}
    for name, at, theta in effects:
        term = Term(name, find_place(ctx, REGISTRY[name], at))
        native[term] = term.effect.export(spec, ctx, term.place, np.array(theta))
    return nominal, spec, native


JOINT = [
    ("viscous_damping", "shoulder", [0.2]),
    ("coulomb_friction", "shoulder", [0.15]),
    ("armature", "shoulder", [0.02]),
]
MASSES = [("payload_mass", "upper", [0.3, 0.0, 0.02, -0.2])]
MJCF_ONLY = [
    ("joint_stiffness", "shoulder", [0.6, 0.1]),
    ("coulomb_friction", "joint_1", [0.1]),
    ("payload_mass", "body_2", [0.2, 0.0, 0.0, -0.25]),
    ("gravity_tilt", "world", [0.1, 0.05]),
    ("actuator_gain", "m", [0.8]),
    ("actuator_gain", "servo", [0.7]),
    ("actuator_bias", "m", [0.3]),
]


@pytest.mark.parametrize("xml", [MJCF, MJCF.replace('angle="degree"', 'inertiafromgeom="true"')])
def test_patched_mjcf_has_the_corrected_parameters(tmp_path, xml):
    path = tmp_path / "arm.xml"
    path.write_text(xml)
    nominal, spec, native = models(path, JOINT + MASSES + MJCF_ONLY)
    assert all(native.values())
    corrected = spec.compile()
    changes = differences(nominal, corrected)
    assert {c.quantity.kind for c in changes} == {"joint", "body", "actuator", "world"}
    own = patched(path, nominal, corrected, changes)
    assert (own.language, own.lacking) == ("MJCF", [])
    again = mujoco.MjModel.from_xml_string(own.text)
    fields = ("dof_damping", "dof_frictionloss", "dof_armature", "jnt_stiffness", "qpos_spring", "body_mass")
    fields += ("body_ipos", "body_inertia", "actuator_gainprm", "actuator_biasprm", "dof_solref")
    for field in fields:
        np.testing.assert_allclose(getattr(again, field), getattr(corrected, field), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(again.opt.gravity, corrected.opt.gravity, rtol=1e-6)
    # What was not corrected stays as it was written.
    kept = [line for line in xml.splitlines() if line in own.text.splitlines()]
    assert len(kept) > 15 and "this remark" in own.text and '<default><joint damping="0.05"/>' in own.text


def test_patched_urdf_has_the_corrected_parameters_and_says_what_it_cannot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    nominal, spec, _ = models(path, [*JOINT, ("coulomb_friction", "elbow", [0.1]), *MASSES])
    corrected = spec.compile()
    own = patched(path, nominal, corrected, differences(nominal, corrected))
    assert own.language == "URDF" and "<!-- kept -->" in own.text
    path.write_text(own.text)
    again = load_spec(path).compile()
    for field in ("dof_damping", "dof_frictionloss", "body_mass", "body_ipos"):
        np.testing.assert_allclose(getattr(again, field), getattr(corrected, field), rtol=1e-6, atol=1e-9)
    # The link that carries a tool keeps it: the sum of both is the corrected body.
    assert corrected.body("upper").mass[0] == pytest.approx(1.5 + 0.4 + 0.3)
    assert '<mass value="1.8"/>' in own.text and '<mass value="0.4"/>' in own.text
    assert own.lacking[0] == "armature of joint shoulder: URDF has no element for it."
    assert all("URDF has no element" in sentence for sentence in own.lacking)
    said = ("mass", "com", "inertia", "damping", "frictionloss")
    assert not any(sentence.startswith(said) for sentence in own.lacking)


def test_a_link_lighter_than_nothing_is_said_not_written(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace('<mass value="1.5"/>', '<mass value="0.1"/>'))
    nominal, spec, _ = models(path, [("mass_scale", "world", [0.5])])
    corrected = spec.compile()
    own = patched(path, nominal, corrected, differences(nominal, corrected))
    assert any(s.startswith("mass of body upper: URDF has no place") for s in own.lacking)
    assert '<mass value="0.25"/>' in own.text, "the other link is corrected all the same"


def result(path, effects):
    """What `write_patch` reads of a result."""
    ctx = nominal_context(compile_variable(load_spec(path)))
    values = {Term(i, find_place(ctx, REGISTRY[i], at)): np.array(theta) for i, at, theta in effects}
    h = Hypothesis.of(*values)
    model = ctx.model
    prepared = SimpleNamespace(spec=load_spec(path), timestep=float(model.opt.timestep))
    fit = SimpleNamespace(hypothesis=h, theta=h.gather(ctx, values))
    return SimpleNamespace(prepared=prepared, ctx=ctx, fit=fit, actuators=None, residual=None, model=path)


def test_the_files_of_a_urdf(tmp_path):
    path, out = tmp_path / "arm.urdf", tmp_path / "out"
    path.write_text(URDF)
    out.mkdir()
    patch.write_patch(result(path, [*JOINT, ("sensor_delay", "elbow", [0.01])]), out)
    table = yaml.safe_load((out / "corrected.yaml").read_text())
    assert table["model"] == "arm.urdf"
    shoulder = table["joints"]["shoulder"]
    assert shoulder["damping"] == {"given": 0.1, "corrected": pytest.approx(0.3), "unit": "N m s/rad"}
    assert shoulder["frictionloss"]["corrected"] == pytest.approx(0.15)
    assert shoulder["armature"] == {"given": 0.0, "corrected": pytest.approx(0.02), "unit": "kg m^2"}
    assert table["only_in_effects_json"] == ["sensor_delay at elbow"]
    assert "armature of joint shoulder: URDF has no element for it." in table["not_in_urdf"]
    assert "sensor_delay at elbow: MuJoCo has no element for it." in table["not_in_urdf"]
    text = (out / "corrected.urdf").read_text()
    assert text.index("<?xml") < text.index("arm.urdf with corrected parameters") < text.index("<robot")
    (tmp_path / "patched.urdf").write_text(text)
    assert load_spec(tmp_path / "patched.urdf").compile().dof_frictionloss[0] == pytest.approx(0.15)
    # The diff makes the same of the user's file.
    if shutil.which("patch"):
        subprocess.run(["patch", str(path), str(out / "corrected.patch")], check=True, capture_output=True)
        assert load_spec(path).compile().dof_damping[0] == pytest.approx(0.3)


def test_without_a_file_or_with_includes_there_is_yaml_alone(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF)
    (tmp_path / "corrected.patch").write_text("of an earlier diagnosis")
    d = result(path, JOINT)
    d.model = None
    patch.write_patch(d, tmp_path)
    assert yaml.safe_load((tmp_path / "corrected.yaml").read_text())["model"] == "nominal.xml"
    assert not (tmp_path / "corrected.patch").exists()
    whole = tmp_path / "scene.xml"
    whole.write_text('<mujoco><include file="arm.xml"/></mujoco>')
    patch.write_patch(result(whole, JOINT), tmp_path)
    table = yaml.safe_load((tmp_path / "corrected.yaml").read_text())
    assert table["not_in_mjcf"][0].startswith("scene.xml is made of other files")
    assert not (tmp_path / "corrected.patch").exists()


def test_a_file_in_another_encoding_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_bytes(
        MJCF.replace('version="1.0"', 'version="1.0" encoding="ISO-8859-1"')
        .encode()
        .replace(b"remark", b"\xe9")
    )
    nominal, spec, _ = models(path, JOINT)
    own = patched(path, nominal, corrected := spec.compile(), differences(nominal, corrected))
    assert own.text is None and own.lacking[0].startswith("arm.xml could not be edited ('utf-8' codec")
