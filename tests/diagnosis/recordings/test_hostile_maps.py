"""Maps made to harm, or by chance: columns or one sentence."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings import column_map
from tests.diagnosis.machines import ARM

LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))


@pytest.mark.parametrize(
    "text",
    [
        "columns: !!python/object/apply:os.system ['touch ran']",
        "columns: {time: !!python/name:os.system }",
        f"{LAUGHS}columns: {{time: {{from: t, unit: *a39}}}}",
        "columns: " + "[" * 10_000,
        "columns: " + "{a: " * 5_000,
        "columns: [1]",
        "x" * (1 << 21),
        "\x00",
    ],
    ids=["call", "name", "laughs", "deep", "deeper", "list", "large", "zero"],
)
def test_a_hostile_map_is_refused_in_one_sentence(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        column_map.load(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    assert [p.name for p in tmp_path.iterdir()] == ["map.yaml"]


@pytest.fixture(scope="module")
def arm():
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    return model, names_of(model)


ANY = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=6)
    | st.lists(st.integers(), max_size=2)
)
ENTRY = st.dictionaries(
    st.sampled_from(["from", "column", "unit", "scale", "offset", "step", "other"]),
    ANY | st.sampled_from(["t", "table", "rad", "deg", "s"]),
    max_size=4,
)
TARGET = st.sampled_from(
    ["time", "qpos:elbow", "ctrl:elbow_servo", "qvel:shoulder", "actuator_force:elbow_servo", "x"]
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(columns=st.dictionaries(TARGET | st.text(max_size=4) | st.integers(), ENTRY | ANY, max_size=3))
def test_any_map_gives_columns_or_one_sentence(tmp_path, arm, columns):
    path, log = tmp_path / "map.yaml", tmp_path / "run.npz"
    path.write_text(yaml.safe_dump({"columns": columns}))
    np.savez(log, t=np.arange(4.0), table=np.zeros((4, 3)))
    try:
        read = column_map.load(path)
        found = column_map.apply(log, {}, read, *arm)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert all(len(v) == 4 for v in found.values())


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(alphabet=st.sampled_from("columns: {}[]&*!|>-#'\"%@\n\tat1.e"), max_size=60))
def test_any_text_is_a_map_or_one_sentence(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_text(text)
    try:
        assert isinstance(column_map.load(path), dict)
    except InputError as error:
        assert "\n" not in str(error)
