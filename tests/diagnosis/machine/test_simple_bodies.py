"""A model whose masses may vary moves as the one that MuJoCo compiles: bodies that only slide among others."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.machine.simple_bodies import only_slide, sliders
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.single_step import Machine
from tests.diagnosis import machines
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import prepared_of

ROBOTS = sorted((Path(__file__).parents[3] / "experiments/blind/robots/mjcf").glob("*.xml"))
GRIPPER = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body name="block"><joint name="carriage" type="slide" axis="0 1 0" stiffness="200" damping="4"/>
<geom name="block" type="box" size=".02 .016 .03" mass=".3"/></body>
<body name="finger" pos="0 -.046 0">
<joint name="finger" type="slide" axis="0 1 0" damping="20" frictionloss="2" armature=".1"/>
<geom name="pad" type="box" size=".01 .005 .02" mass=".13"/></body>
<body name="lever" pos="0 1 0"><joint name="lever" axis="1 0 0"/>
<geom name="bar" type="capsule" fromto="0 0 0 0 0 .2" size=".02" mass=".1"/>
</body></worldbody><actuator><motor name="push" joint="finger"/></actuator></mujoco>"""


def as_mujoco(armature: float = 0.1, masses: float = 1.0) -> mujoco.MjModel:
    """As MuJoCo compiles the gripper with another armature of the finger, or all masses that many times as large."""
    spec = mujoco.MjSpec.from_string(GRIPPER)
    spec.joint("finger").armature = armature
    for geom in spec.geoms:
        geom.mass *= masses
    return spec.compile()


EVERY = {"GRIPPER": GRIPPER} | {k: x for k, x in vars(machines).items() if str(x).startswith("<mujoco")}
EVERY |= {path.stem: path.read_text() for path in ROBOTS}


@pytest.mark.parametrize("name", EVERY)
def test_a_variable_model_moves_as_the_given_one(name):
    spec, ends = mujoco.MjSpec.from_string(EVERY[name]), []
    for m in (spec.copy().compile(), compile_variable(spec)):
        data, rng = mujoco.MjData(m), np.random.default_rng(0)
        data.qvel[:] = 0.3 * rng.standard_normal(m.nv)
        for _ in range(10):
            data.ctrl[:] = 0.3 * rng.standard_normal(m.nu)
            mujoco.mj_step(m, data, 20)
        ends.append(np.array(data.qpos))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


def weights(m: mujoco.MjModel) -> np.ndarray:
    return np.concatenate([m.body_invweight0.ravel(), m.dof_invweight0])


def squeezed(m: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(m)
    data.ctrl[:] = 8.0
    mujoco.mj_step(m, data, 500)
    return np.array(data.qpos)


def test_bodies_that_only_slide_weigh_as_in_the_given_model():
    plain, m = as_mujoco(), compile_variable(mujoco.MjSpec.from_string(GRIPPER))
    assert plain.body_simple[1] == 2 and not m.body_simple[1:].any()
    np.testing.assert_array_equal(weights(m), weights(plain))
    assert sliders(m) == [1, 2]
    # it presses on the block, whose contact yields as the given model's does
    assert squeezed(plain)[0] > 0.01
    np.testing.assert_allclose(squeezed(m), squeezed(plain), atol=1e-12)
    arm = compile_variable(mujoco.MjSpec.from_string(ARM))
    assert list(np.flatnonzero(only_slide(m))) == [1, 2] and not only_slide(arm).any() and sliders(arm) == []


@pytest.mark.parametrize(
    ("effect", "place", "value", "change"),
    [
        ("armature", Place("joint", "finger", 1), 0.2, {"armature": 0.3}),
        ("mass_scale", Place("world", "world", 0), 2.0, {"masses": 2.0}),
    ],
)
def test_they_do_with_other_masses_too(effect, place, value, change):
    m = compile_variable(mujoco.MjSpec.from_string(GRIPPER))
    ctx, want = nominal_context(m), as_mujoco(**change)
    term = Term(effect, place)
    alone = Machine.build(ctx, (term,), (np.array([value]),)).model
    np.testing.assert_allclose(weights(alone), weights(want), rtol=1e-12)
    np.testing.assert_allclose(squeezed(alone), squeezed(want), atol=1e-12)


def test_windows_are_simulated_with_these_weights():
    p = prepared_of(GRIPPER, record(GRIPPER, 6.0))
    term = Term("armature", Place("joint", "finger", 1))
    w = p.windows("train", 0.2, 5)
    sim = Simulator(p.model, p.ctx)
    told = {
        mass: sim.residuals([Run(Hypothesis.of(term), np.array([mass]))], w)[0, ..., : p.model.nv]
        for mass in (0.0, 1e-9)
    }
    plain = sim.residuals([Run(Hypothesis(), np.zeros(0))], w)[0, ..., : p.model.nv]
    # armature asks for derived numbers anew, and none of it changes nothing
    for mass in told:
        np.testing.assert_allclose(told[mass], plain, atol=1e-7)
