from __future__ import annotations

import mujoco
import pytest

from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from tests.diagnosis.machines import ARM


@pytest.fixture(scope="session")
def arm():
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    return model, names_of(model)
