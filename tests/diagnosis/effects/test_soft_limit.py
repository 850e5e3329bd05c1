"""A torque limit with a soft knee."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.soft_limit import HARD
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.closer_forms import closer
from mpge_jax.diagnosis.simulation.single_step import Machine, force_start, force_step, observe
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import MOTOR, fitted, reported, search_of

ID, PLAIN = "torque_saturation:soft", Term("torque_saturation", MOTOR)
LIMIT = 0.5
LIMITED = PENDULUM.replace("<motor ", '<motor forcerange="-0.4 0.4" ')


def given(xml: str, command: float, softness: float) -> float:
    """Force (N m) on the joint from one command, with a limit of 0.5 N m."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    theta = REGISTRY[ID].from_report(ctx, MOTOR, {"limit": LIMIT, "softness": softness})
    m, zero = Machine.build(ctx, (Term(ID, MOTOR),), (theta,)), np.zeros(1)
    free = np.array([command])
    step = observe(np, m, zero, zero, free, lambda _: np.zeros(3), free, 0.01, zero, lambda _: 1.0)
    applied, _ = force_step(np, m, step, force_start(np, m, step))
    return float(step.f[0] + applied.qfrc[0])


def test_its_knee_is_that_of_a_p_norm():
    """With softness 0.2, p is 5: at the limit itself 0.5 / 2^0.2 N m are left, far below it nearly all."""
    for sign in (1.0, -1.0):
        assert given(PENDULUM, sign * 0.5, 0.2) == pytest.approx(sign * 0.5 / 2**0.2)
        assert given(PENDULUM, sign * 0.1, 0.2) == pytest.approx(sign * 0.1, rel=1e-3)
        assert given(PENDULUM, sign * 2.9, 0.2) == pytest.approx(sign * 0.5, rel=1e-3)
        assert given(PENDULUM, sign * 0.45, 0.0) == pytest.approx(sign * 0.45, rel=0.01)
    assert given(PENDULUM, 0.0, 0.2) == 0.0
    # the drive's own limit holds too
    assert given(LIMITED, 3.0, 0.2) == pytest.approx(0.4)


def test_it_is_for_drives_of_joints_and_for_those_that_follow_their_command():
    """What others lose can only be taken from their command, which does not tell their force."""
    tendon = '<tendon><fixed name="belt"><joint joint="hinge" coef="1"/></fixed></tendon></mujoco>'
    belted = PENDULUM.replace('joint="hinge" ctrlrange', 'tendon="belt" ctrlrange')
    slow = belted.replace("<motor ", '<general dyntype="filter" dynprm=".1" ')
    fits = []
    for xml in (PENDULUM, *(x.replace("</mujoco>", tendon) for x in (belted, slow))):
        ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
        fits.append(REGISTRY[ID].fits(ctx, MOTOR))
    assert fits == [True, True, False]


@pytest.mark.parametrize("softness", [0.2, 0.0], ids=["soft", "sharp"])
def test_it_is_asked_for_where_a_drive_saturates(softness):
    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        u = float(data.ctrl[0])
        p = 1.0 / max(softness, HARD)
        soft = u / (1.0 + abs(u / LIMIT) ** p) ** (1.0 / p)
        data.qfrc_applied[0] = (soft if softness else float(np.clip(u, -LIMIT, LIMIT))) - u

    s = search_of(PENDULUM, record(PENDULUM, 0.8, force=force, seconds=3.0))[0]
    plain, _ = final_fit(s, fitted(s, {PLAIN: [LIMIT]}))
    found = closer(s, plain)
    if not softness:
        assert found is plain
        return
    values = reported(s, found)
    assert found.hypothesis.terms[0].id == ID and values["softness"] == pytest.approx(softness, abs=0.03)
    assert values["limit"] == pytest.approx(LIMIT, rel=0.05)
