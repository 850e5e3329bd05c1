"""GAIL with TRPO by `imitation`, run by a Python that has it: prints the seconds of 2,048 steps for each line it reads.

It wants gymnasium below 1, which this project does not: it has a virtual environment of its own, and no import of ours.
"""

import sys
import time

import gymnasium
import numpy as np
from imitation.algorithms.adversarial.gail import GAIL
from imitation.data.types import Transitions
from imitation.rewards.reward_nets import BasicRewardNet
from imitation.util.networks import RunningNorm
from sb3_contrib import TRPO
from stable_baselines3.common.vec_env import DummyVecEnv

COPIES, STEPS, SAMPLES = 8, 2_048, 5_000


def main() -> None:
    """Reads lines until there are no more."""
    env = DummyVecEnv([lambda: gymnasium.make("HalfCheetah-v4")] * COPIES)
    draw = np.random.default_rng(0)
    observations = draw.normal(size=(SAMPLES, *env.observation_space.shape))
    log = Transitions(
        obs=observations[:-1],
        acts=draw.uniform(-1.0, 1.0, (SAMPLES - 1, *env.action_space.shape)).astype(np.float32),
        infos=np.array([{}] * (SAMPLES - 1)),
        next_obs=observations[1:],
        dones=np.zeros(SAMPLES - 1, bool),
    )
    learner = TRPO(
        "MlpPolicy", env, n_steps=STEPS // COPIES, gamma=0.0, target_kl=0.01, cg_max_steps=15, cg_damping=0.1,
        sub_sampling_factor=5, batch_size=128, n_critic_updates=5, policy_kwargs={"net_arch": [64, 64]}, device="cpu",
    )  # fmt: skip
    reward = BasicRewardNet(
        env.observation_space, env.action_space, use_next_state=True, hid_sizes=(256, 256),
        normalize_input_layer=RunningNorm,
    )  # fmt: skip
    gail = GAIL(
        demonstrations=log, demo_batch_size=512, venv=env, gen_algo=learner, reward_net=reward,
        n_disc_updates_per_round=4, gen_train_timesteps=STEPS, gen_replay_buffer_capacity=STEPS,
        allow_variable_horizon=True,
    )  # fmt: skip
    for _ in sys.stdin:
        start = time.perf_counter()
        gail.train(STEPS)
        print(f"took {time.perf_counter() - start:.6f}", flush=True)


if __name__ == "__main__":
    main()
