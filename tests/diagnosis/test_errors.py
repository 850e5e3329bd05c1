"""An error of the user's input is one line, whatever the input was called."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, InputError, diagnose
from tests.diagnosis.machines import PENDULUM


@pytest.mark.parametrize(
    ("name", "told"),
    [("a\nb", r"a\nb"), ("\r\x1b[31m", r"\r\x1b[31m"), ("\u2028", r"\u2028"), ("Küche µ", "Küche µ")],
)
def test_what_cannot_be_printed_is_escaped(name, told):
    assert str(InputError(f"there is no '{name}'.")) == f"there is no '{told}'."


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"seed": "x"}, "seed must be a whole number, got 'x'."),
        ({"jobs": 1.5}, "jobs must be a whole number, got 1.5."),
        ({"max_effects": "3"}, "max_effects must be a whole number or None, got '3'."),
        ({"decide_s": None}, "decide_s must be a number, got None."),
    ],
)
def test_settings_of_another_type_are_told(settings, told):
    with pytest.raises(ValueError) as error:
        Config(**settings)
    assert str(error.value) == told
    assert Config(seed=np.int64(3), decide_s=1).seed == 3


def test_what_is_no_recording_is_told(tmp_path):
    t = 0.01 * np.arange(20)
    np.savez(tmp_path / "run.npz", time=t, qpos=t, ctrl=t)
    model = mujoco.MjSpec.from_string(PENDULUM)
    with np.load(tmp_path / "run.npz") as opened:
        for given, name in (
            (opened, "NpzFile"),
            (dict(opened), "dict"),
            ([opened["qpos"]], "ndarray"),
            (None, "None"),
        ):
            with pytest.raises(InputError, match=rf"^recordings are paths or Recording\(.*\), not {name}"):
                diagnose(model, given)
