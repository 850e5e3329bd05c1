"""What the engines refuse, and what happens to a simulation that is lost."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from envs import registry
from envs.c_engine import _MOST_BATCHES, CEngine
from tests.envs.compiled import assert_follows_mj_step, compiled

ROOT = Path(__file__).resolve().parents[2]

SLIDER = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="b"><joint name="x" type="slide" axis="1 0 0" {joint}/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><motor joint="x" ctrlrange="-1 1" {motor}/></actuator>
  {more}
</mujoco>
"""


PLAIN = SLIDER.format(joint="", motor="", more="")


def model(joint="", motor="", more=""):
    return mujoco.MjModel.from_xml_string(SLIDER.format(joint=joint, motor=motor, more=more))


def test_c_engine_is_mujoco_with_all_it_carries():
    """Activations, sensors and time against a loop over `mj_step`."""
    edited = model(
        motor='/><general joint="x" dyntype="filter" dynprm="0.1" gainprm="2" ctrlrange="-1 1"',
        more='<sensor><jointpos joint="x"/><jointvel joint="x"/></sensor>',
    )
    assert (edited.na, edited.nu, edited.nsensordata) == (1, 2, 2)
    assert_follows_mj_step(CEngine(edited), edited, rtol=2e-5, atol=1e-7)


def test_a_diverged_simulation_is_lost_and_alone(capfd):
    """MuJoCo would put it back to its initial state without a word to the caller."""
    engine = CEngine(model(joint='springref="1" stiffness="1e9"'))
    start = jnp.array([[0.0], [1.0]])  # far from the spring's rest, and at it
    data = jax.vmap(engine.init)(start, jnp.zeros((2, 1)))
    step = jax.jit(jax.vmap(lambda d, u: engine.step(d, u, 50)))
    for _ in range(20):
        data = step(data, jnp.zeros((2, 1)))
    assert np.isnan(data.qpos[0]).all() and np.isnan(data.time[0])
    np.testing.assert_array_equal(data.qpos[1], [1.0])
    capfd.readouterr()


def test_nan_is_not_logged(capfd):
    engine = CEngine(model())
    data = engine.step(engine.init(jnp.zeros(1), jnp.zeros(1)), jnp.full(1, jnp.nan), 2)
    assert np.isnan(data.qpos).all()
    assert "WARNING" not in "".join(capfd.readouterr())


def test_batches_are_bounded():
    engine = CEngine(model())
    step = jax.jit(jax.vmap(lambda d, u: engine.step(d, u, 1)))
    for size in range(1, _MOST_BATCHES + 4):
        data = jax.vmap(engine.init)(jnp.zeros((size, 1)), jnp.zeros((size, 1)))
        np.testing.assert_allclose(step(data, jnp.ones((size, 1))).qvel, np.full((size, 1), 0.002), rtol=1e-6)
    assert len(engine._batches) == _MOST_BATCHES


def test_delays_need_float64():
    delayed = model(motor='delay="0.01" nsample="8"')
    with pytest.raises(ValueError, match=r"delayed actuators or sensors.*jax_enable_x64"):
        CEngine(delayed).init(jnp.zeros(1), jnp.zeros(1))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"motor": 'delay="0.01" nsample="8"'}, "actuator_delay"),
        ({"joint": 'damping="1 2"'}, "dof_dampingpoly"),
        ({"joint": 'stiffness="1 2"'}, "jnt_stiffnesspoly"),
    ],
)
def test_mjx_refuses_what_it_would_ignore(changes, name):
    from envs.mjx_engine import MJXEngine

    with pytest.raises(
        ValueError, match=f"MJX does not compute {name}, which this model uses: take backend 'c'"
    ):
        MJXEngine(model(**changes))


def test_mjx_refuses_in_one_sentence():
    from envs.mjx_engine import MJXEngine

    with pytest.raises(ValueError, match=r"MJX cannot simulate this model .*: take backend 'c'"):
        edited = model()
        edited.opt.solver = mujoco.mjtSolver.mjSOL_PGS
        MJXEngine(edited)


def test_warp_is_for_nvidia():
    try:
        jax.devices("cuda")
    except RuntimeError:
        with pytest.raises(ValueError, match="backend 'warp' needs an NVIDIA GPU and Warp"):
            envs.make("InvertedPendulum", backend="warp")
        return
    case = compiled("InvertedPendulum", "warp")
    reference = compiled("InvertedPendulum", "c")
    ours = case.step(case.start(), case.actions())
    np.testing.assert_allclose(ours.obs, reference.step(reference.start(), case.actions()).obs, atol=1e-5)


def test_auto_is_the_c_engine_on_cpu():
    if jax.default_backend() != "cpu":
        pytest.skip("this machine computes on an accelerator")
    assert isinstance(envs.make("Hopper").engine, CEngine)


@pytest.mark.parametrize("has_warp", [True, False])
def test_auto_on_an_accelerator_is_warp_where_it_can_be_had(monkeypatch, has_warp):
    from envs import mjx_engine, warp_engine

    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(registry, "_has_warp", lambda: has_warp)
    monkeypatch.setattr(mjx_engine, "MJXEngine", lambda model: "mjx")
    monkeypatch.setattr(warp_engine, "WarpEngine", lambda model: "warp")
    model = mujoco.MjModel.from_xml_string(PLAIN)
    assert registry.engine_of(model) == ("warp" if has_warp else "mjx")


def python(code, *args):
    command = [sys.executable, "-c", code, *args]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=200)


# Arguments of a megabyte, which JAX puts on the device asynchronously; one core, so one thread to do it.
BUSY = """
import os, sys
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import jax
import jax.numpy as jnp
jax.block_until_ready(jnp.ones(3))
import mujoco
from envs.c_engine import CEngine
assert jax.config.read("jax_cpu_enable_async_dispatch")
engine, copies, length = CEngine(mujoco.MjModel.from_xml_string(sys.argv[1])), int(sys.argv[2]), int(sys.argv[3])
def pushed(data, _):
    left, right = (jax.vmap(lambda d: engine.step(d, jnp.full(1, push), 1))(data) for push in (-1.0, 1.0))
    return jax.tree.map(lambda x, y: 0.5 * (x + y), left, right), None
run = jax.jit(lambda data: jax.lax.scan(pushed, data, None, length)[0])
zeros = jnp.zeros((copies, 1))
data = jax.vmap(engine.init)(zeros, zeros)
# What waits for another computation is run by the thread that also puts arguments on the device.
for _ in range(6):
    data = run(jax.tree.map(lambda x: x + 1, data))
"""


def test_the_c_engine_does_not_wait_for_its_own_thread():
    """With asynchronous dispatch, JAX's default; the time limit is that of a hang."""
    done = python(BUSY + "print(data.time.max() > 3)", PLAIN, "100000", "2")
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


# In its last call `run` waits for a matrix that is still being multiplied, and the program for nothing.
LEAVING = """
import jax
import jax.numpy as jnp
import envs
env = envs.make("HalfCheetah", "c")
step = jax.vmap(env.step)
run = jax.jit(lambda state: jax.lax.scan(lambda s, _: (step(s, jnp.zeros((100, 6))), None), state, None, 20)[0])
state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 100))
ones = jnp.ones((2000, 2000))
for _ in range(3):
    late = ones @ ones
    state = run(state.replace(data=state.data.replace(qpos=state.data.qpos + 0 * late[0, 0])))
"""


def test_a_program_may_end_while_it_computes():
    done = python(LEAVING)
    assert done.returncode == 0, done.stderr


def test_mjx_is_imported_in_silence():
    done = python("import envs; envs.make('InvertedPendulum', backend='mjx')")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
