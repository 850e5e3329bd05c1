"""Descriptions made to harm, or by chance: one sentence, soon, and nothing read that they may not read."""

from __future__ import annotations

import tracemalloc

import mujoco
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec
from tests.diagnosis.machines import ARM

BODY = '<body><joint/><geom size=".1"/></body>'


def _encoded(text: str, encoding: str) -> bytes:
    return f'<?xml version="1.0" encoding="{encoding}"?>{text}'.encode(encoding)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'<!DOCTYPE m [<!ENTITY a "x">]><mujoco/>', "DOCTYPE or ENTITY"),
        (b'<!DOCTYPE m SYSTEM "/etc/passwd"><mujoco/>', "DOCTYPE or ENTITY"),
        (_encoded('<!DOCTYPE m [<!ENTITY a SYSTEM "/etc/passwd">]><m n="&a;"/>', "utf-16"), "DOCTYPE or ENTITY"),
        (b'<?xml version="1.0" encoding="cp037"?>' + '<!DOCTYPE m><m/>'.encode("cp037"), "form|DOCTYPE|encod"),
        (f'<mujoco><worldbody><replicate count="1000000000">{BODY}</replicate></worldbody></mujoco>', "1e[+]09 copies"),
        (
            f'<mujoco><worldbody><replicate count="200"><replicate count="200">{BODY}</replicate></replicate>'
            "</worldbody></mujoco>",
            "4e[+]04 copies",
        ),
        ('<mujoco><worldbody><composite type="cable" count="99999 1 1"/></worldbody></mujoco>', "1e[+]05 copies"),
        ('<mujoco><asset><texture builtin="flat" width="1000000" height="1000000"/></asset></mujoco>', "1e[+]12"),
        ('<mujoco><asset><hfield nrow="100000" ncol="100000" size="1 1 1 1"/></asset></mujoco>', "1e[+]10 points"),
        ('<mujoco><size memory="1E"/></mujoco>', "more than a machine has"),
        ("<a>" * 20_000 + "</a>" * 20_000, "cannot load|well-formed"),
        (b"\xff\xfe<\x00", "well-formed|encod"),
    ],
)  # fmt: skip
def test_a_hostile_description_is_refused_in_one_sentence(tmp_path, text, message):
    path = tmp_path / "m.xml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    tracemalloc.start()
    with pytest.raises(InputError, match=message) as caught:
        load_spec(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    assert "root:" not in str(caught.value) and most < 200e6


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "m.urdf",
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="leg"/></robot>',
            "m.urdf holds macros of xacro; write them out first: xacro m.urdf > robot.urdf",
        ),
        ("m.urdf", '<robot name="a"><link name="${side}"/></robot>', "holds macros of xacro"),
        ("m.txt", "<mujoco/>", "MuJoCo reads MJCF from files that end in .xml; rename m.txt"),
    ],
)
def test_descriptions_that_have_to_be_changed_first_are_told_how(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_spec(tmp_path / name)
    assert "cannot load" not in str(caught.value)


def test_what_is_no_model_is_told():
    with pytest.raises(InputError, match="a model is the path of a file or an MjSpec, not NoneType"):
        load_spec(None)


def test_copies_that_are_not_many_are_made(tmp_path):
    path = tmp_path / "m.xml"
    path.write_text(
        f'<mujoco><worldbody><replicate count="3" offset="1 0 0">{BODY}</replicate></worldbody></mujoco>'
    )
    assert load_spec(path).compile().nbody == 4


NUMBERS = (
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "99999999999",
    "",
    "a b c",
    "1 2 3 4 5 6 7 8 9",
    "true",
    "1e-320",
)
ATTRIBUTES = ARM.count('="')


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    which=st.integers(0, ATTRIBUTES - 1),
    value=st.sampled_from(NUMBERS) | st.text(max_size=8),
    flip=st.none() | st.integers(0, 8 * len(ARM) - 1),
)
@pytest.mark.filterwarnings("ignore:Inertia matrix is too close to singular")
def test_a_description_with_any_value_or_bit_gives_a_model_or_one_sentence(
    tmp_path, capfd, which, value, flip
):
    parts = ARM.split('="')
    rest = parts[which + 1].partition('"')[2]
    text = bytearray(
        '="'.join([*parts[: which + 1], f'{value}"{rest}', *parts[which + 2 :]]).encode("utf-8", "replace")
    )
    if flip is not None:
        text[flip // 8 % len(text)] ^= 1 << flip % 8
    path = tmp_path / "m.xml"
    path.write_bytes(bytes(text))
    try:
        assert compile_variable(load_spec(path)).nbody >= 1
    except InputError as error:
        assert "\n" not in str(error)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("idx"), inner, max_size=3),
    max_leaves=5,
)
ENTRY = st.fixed_dictionaries(
    {
        "id": st.sampled_from(["coulomb_friction", "payload_mass", "backlash"]) | JSON,
        "at": st.sampled_from(["elbow", "fore"]) | JSON,
    },
    optional={
        "form": JSON,
        "kind": st.sampled_from(["joint", "body"]) | JSON,
        "parameters": st.dictionaries(
            st.sampled_from(["torque", "mass", "gap", "position"]), JSON, max_size=3
        )
        | JSON,
    },
)


@settings(max_examples=40, deadline=None)
@given(effects=st.lists(ENTRY | JSON, min_size=1, max_size=2))
def test_any_table_of_effects_gives_a_machine_or_one_sentence(effects):
    try:
        CorrectedModel.build(mujoco.MjSpec.from_string(ARM), effects)
    except InputError as error:
        assert "\n" not in str(error)
