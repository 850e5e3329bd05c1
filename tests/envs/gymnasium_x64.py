"""Prints, for each task, how far 1,000 steps in float64 are from Gymnasium's. Run with JAX_ENABLE_X64=1."""

import json

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import envs

log = mujoco.MjLogConfig.get()
log.logto_file = False
log.set()


def compare(name: str) -> dict[str, float]:
    """Largest differences; both start again from the same state where an episode ends."""
    theirs = gymnasium.make(f"{name}-v4").unwrapped
    ours = envs.make(name, "c")
    step = jax.jit(ours.step)
    rng = np.random.default_rng(0)
    qpos = theirs.init_qpos + rng.uniform(-5e-3, 5e-3, theirs.model.nq)
    qvel = rng.uniform(-5e-3, 5e-3, theirs.model.nv)
    if name != "InvertedPendulum":
        qpos[0] = 0.0

    def reset():
        mujoco.mj_resetData(theirs.model, theirs.data)
        theirs.set_state(qpos, qvel)
        return ours.state_from_obs(jnp.asarray(theirs._get_obs()))

    state = reset()
    observation = reward = disagreements = episodes = 0.0
    for _ in range(1000):
        action = rng.uniform(ours.action_low, ours.action_high)
        obs, gain, terminated, _, _ = theirs.step(action)
        state = step(state, jnp.asarray(action))
        observation = max(observation, float(np.abs(np.asarray(state.obs) - obs).max()))
        reward = max(reward, abs(float(state.reward) - gain))
        disagreements += bool(state.info["terminated"]) != terminated
        if terminated:
            state = reset()
            episodes += 1
    return {
        "observation": observation,
        "reward": reward,
        "disagreements": disagreements,
        "episodes": episodes,
        "bytes": state.obs.dtype.itemsize,
    }


if __name__ == "__main__":
    print(json.dumps({name: compare(name) for name in ("InvertedPendulum", "Hopper", "HalfCheetah")}))
