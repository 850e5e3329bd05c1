"""Dry friction behind a gap and a spring."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.single_step import Machine, force_start, force_step, observe
from tests.diagnosis.machines import PENDULUM

ID = "coulomb_friction:behind_gap"


def test_friction_behind_a_gap_is_a_loop_with_free_travel():
    """Fc = 2 N m, yields by 0.1 rad, gap 0.2 rad: to and fro between 0 and 1 rad."""
    ctx, effect = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM))), REGISTRY[ID]
    (place,), theta = effect.places(ctx), np.array([2.0, 0.1, 0.2])
    q = np.concatenate([np.arange(0.0, 1.01, 0.05), np.arange(0.95, -0.01, -0.05)])
    force = -effect.along(ctx, place, theta, q[:, None])
    # outwards: free for half the gap, then the spring of 20 N m/rad, then sliding
    np.testing.assert_allclose(force[[0, 2, 3, 4, 20]], [0.0, 0.0, 1.0, 2.0, 2.0], atol=1e-9)
    # back: unloaded after 0.1 rad, free for 0.2 rad, loaded after another 0.1 rad
    np.testing.assert_allclose(
        force[[21, 22, 24, 26, 27, 28, 40]], [1.0, 0.0, 0.0, 0.0, -1.0, -2.0, -2.0], atol=1e-9
    )
    assert effect.report(ctx, place, theta) == pytest.approx({"torque": 2.0, "stiffness": 20.0, "gap": 0.2})


def test_step_by_step_it_is_what_it_is_along_the_whole_motion():
    ctx, effect = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM))), REGISTRY[ID]
    (place,), theta = effect.places(ctx), np.array([2.0, 0.1, 0.2])
    machine = Machine.build(ctx, (Term(ID, place),), (theta,))
    dt, t = 0.01, 0.01 * np.arange(300)
    q = np.sin(2 * t) + 0.3 * np.sin(7 * t)
    want = effect.along(ctx, place, theta, q[:, None])
    memory, zero = None, np.zeros(1)
    for k in range(1, len(t)):
        v = np.array([(q[k] - q[k - 1]) / dt])
        step = observe(
            np, machine, q[k : k + 1], v, zero, lambda _: np.zeros(3), zero, dt, zero, lambda _: 1.0
        )
        start = force_start(np, machine, step) if memory is None else memory
        applied, memory = force_step(np, machine, step, start)
        np.testing.assert_allclose(applied.qfrc, want[k : k + 1], atol=1e-9)


def test_only_recordings_of_force_ask_for_it():
    """Its memory in windows of driven machines is not known: there the plain law is tried."""
    assert REGISTRY[ID].traced and not REGISTRY[ID].simulated
    assert [i for i, e in REGISTRY.items() if not e.simulated] == [ID]
