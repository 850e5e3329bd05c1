"""MJX-Warp against MuJoCo's C engine, wherever Warp is installed: it computes on CPU too, slowly."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs
from mpge_jax.grounding import adversarial
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.rollouts import policies, target_log
from tests.envs.compiled import assert_follows_mj_step

pytest.importorskip("warp")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),
]  # its kernels take a quarter of a minute

from envs.warp_engine import WarpEngine  # noqa: E402

SLIDER = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator>
    <motor joint="x" {motor}/>
    <general joint="x" dyntype="filter" dynprm="0.1" gainprm="2"/>
  </actuator>
  <sensor><jointpos joint="x"/><jointvel joint="x"/></sensor>
</mujoco>
"""
BALLS = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.09"><freejoint/><geom size="0.1"/></body>
    <body pos="1 0 0.09"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_it_is_mujoco_with_all_it_carries():
    """Activations, sensors and time against a loop over `mj_step`; the state survives the end of each call."""
    model = mujoco.MjModel.from_xml_string(SLIDER.format(motor=""))
    assert (model.na, model.nu, model.nsensordata) == (1, 2, 2)
    assert_follows_mj_step(WarpEngine(model, copies=1), model, rtol=2e-4, atol=1e-6)


def test_copies_of_copies_are_the_c_engines():
    """Two rows of three cheetahs that fall to the ground; states are branched and taken apart as any arrays are."""
    plain, warp = envs.make("HalfCheetah", "c"), envs.make("HalfCheetah", "c")
    warp.engine = WarpEngine(warp.model, copies=6)
    keys = jax.random.split(jax.random.key(0), 3)
    actions = jax.random.uniform(jax.random.key(1), (12, 2, 3, 6), minval=-1.0, maxval=1.0)

    def roll(env):
        state = jax.vmap(env.reset)(keys)
        state = jax.tree.map(lambda x: jnp.broadcast_to(x, (2, *x.shape)), state)
        step = jax.jit(jax.vmap(jax.vmap(env.step)))
        for action in actions:
            state = step(state, action)
        return state

    ours, theirs = roll(warp), roll(plain)
    assert {x.shape[:2] for x in jax.tree.leaves(ours)} == {(2, 3)}
    np.testing.assert_allclose(ours.obs, theirs.obs, atol=0.02)
    np.testing.assert_allclose(ours.data.time, theirs.data.time, rtol=1e-5)
    assert float(jnp.abs(ours.obs[0] - ours.obs[1]).max()) > 1.0  # the rows had actions of their own


def test_transformers_are_grounded_as_on_the_c_engine():
    """Two members, branched simulators, one iteration: what is learned from does not depend on the engine."""
    plain, warp = envs.make("InvertedPendulum", "c"), envs.make("InvertedPendulum", "c")
    warp.engine = WarpEngine(warp.model, copies=256)
    rollout = policies.shipped("InvertedPendulum", "MS")[0].rollout
    log = target_log.collect(jax.random.key(0), plain, rollout, 200)
    config = GroundingConfig(num_envs=64, steps_per_iteration=2, branches=2)

    def ground(env):
        keys = jax.random.split(jax.random.key(1), 2)
        state = jax.jit(jax.vmap(lambda key: adversarial.init(key, env, rollout, log, config)))(keys)
        return jax.jit(jax.vmap(lambda s: adversarial.update(s, env, rollout, log, config)))(state)[1]

    ours, theirs = ground(warp), ground(plain)
    for name, value in theirs.items():
        np.testing.assert_allclose(ours[name], value, rtol=0.02, atol=0.01, err_msg=name)


def test_a_contact_without_room_is_not_left_out_in_silence():
    model = mujoco.MjModel.from_xml_string(BALLS)
    wide, narrow = WarpEngine(model, copies=4), WarpEngine(model, copies=1)
    start = jnp.tile(jnp.asarray(mujoco.MjData(model).qpos, jnp.float32), (4, 1))

    def after(engine):
        data = jax.vmap(engine.init)(start, jnp.zeros((4, model.nv)))
        return jax.jit(jax.vmap(lambda d: engine.step(d, jnp.zeros(0), 2)))(data).qpos

    assert np.isfinite(after(wide)).all()
    lost = ~np.isfinite(after(narrow)).all(axis=1)
    assert lost.any()
    np.testing.assert_allclose(after(narrow)[~lost], after(wide)[~lost], atol=1e-5)


def test_what_it_does_not_carry_is_refused():
    model = mujoco.MjModel.from_xml_string(SLIDER.format(motor='delay="0.01" nsample="8"'))
    with pytest.raises(
        ValueError, match="MJX-Warp does not carry history, which this model has: take backend 'c'"
    ):
        WarpEngine(model)
