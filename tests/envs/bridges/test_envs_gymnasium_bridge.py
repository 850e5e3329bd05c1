"""Gymnasium's checks on our environments, and its vector environments as the measure of ours."""

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import envs
from mpge_jax import GroundedEnv
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel
from mpge_jax.diagnosis.corrected.tasks import nominal_spec, task_env
from tests import small
from tests.envs.compiled import compiled

# Short episodes, so that a few steps see both ends: a pendulum pushed hard falls, one left alone is cut.
LIMIT = 9


class Short(envs.Wrapper):
    """The pendulum with a time limit of a few steps."""

    max_steps = LIMIT

    def step(self, state, action):
        after = self._env.step(state, action)
        cut = (after.info["steps"] >= LIMIT).astype(after.obs.dtype)
        done = jax.numpy.maximum(after.info["terminated"], cut)
        return after.replace(done=done, info={**after.info, "truncated": cut})


@pytest.fixture(scope="module")
def short():
    return Short(compiled("InvertedPendulum").env)


def corrected():
    effects = [{"id": "viscous_damping", "at": "hinge", "parameters": {"coefficient": 0.5}}]
    model = CorrectedModel.build(nominal_spec("InvertedPendulum"), effects)
    return task_env(model, "InvertedPendulum")


def grounded():
    env = small.env("InvertedPendulum")
    return GroundedEnv(env, small.stacked(small.constant(env, 0.5), small.constant(env, -0.5)))


@pytest.mark.parametrize(
    "make", [lambda: small.env("SkewedPendulum"), lambda: small.env("BrokenCheetah"), grounded, corrected]
)
@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*:UserWarning")
@pytest.mark.filterwarnings("ignore:.*For Box action spaces, we recommend:UserWarning")
def test_gymnasium_accepts_targets_grounded_and_corrected_environments(make):
    env = envs.as_gymnasium(make())
    check_env(env, skip_render_check=True)
    assert env.observation_space.dtype == env.reset()[0].dtype == np.float32


def test_steps_are_those_of_the_environment():
    ours = compiled("HalfCheetah")
    env = envs.as_gymnasium(ours.env)
    first, info = env.reset(seed=3)
    assert info == {} and first.shape == (17,)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (6,), np.float32)
    action = np.linspace(-1, 1, 6, dtype=np.float32)
    obs, reward, terminated, truncated, info = env.step(action)
    np.testing.assert_allclose(obs, ours.env.predict(first, jax.numpy.asarray(action)), atol=1e-4)
    assert reward == pytest.approx(info["reward_run"] + info["reward_control"], rel=1e-5)
    assert info["reward_control"] == pytest.approx(-0.1 * np.sum(action**2), rel=1e-5)
    assert (terminated, truncated) == (False, False) and type(reward) is float
    # Another episode, and the same one again.
    assert np.any(env.reset()[0] != first)
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)


def test_time_is_truncation_and_falling_termination(short):
    env = envs.as_gymnasium(short)
    env.reset(seed=0)
    ends = [env.step(np.zeros(1, np.float32))[2:4] for _ in range(LIMIT)]
    assert ends == [(False, False)] * (LIMIT - 1) + [(False, True)]
    env.reset()
    ends = [env.step(np.full(1, 3, np.float32))[2:4] for _ in range(LIMIT - 1)]
    assert (True, False) in ends and (False, True) not in ends


def test_there_must_be_an_episode(short):
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        envs.as_gymnasium(short).step(np.zeros(1, np.float32))
    vector = envs.as_gymnasium_vector(short, 2)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        vector.step(np.zeros((2, 1), np.float32))
    with pytest.raises(gymnasium.error.ResetNeeded, match="of all copies"):
        vector.reset(options={"reset_mask": np.array([True, False])})


def assert_same(ours, theirs, path=""):
    """Nested infos and arrays, those of objects element by element."""
    if isinstance(theirs, tuple):
        ours, theirs = dict(enumerate(ours)), dict(enumerate(theirs))
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs), path
        for name in theirs:
            assert_same(ours[name], theirs[name], f"{path}/{name}")
    elif isinstance(theirs, np.ndarray) and theirs.dtype.kind == "O":
        assert [x is None for x in ours] == [x is None for x in theirs], path
        for a, b in zip(ours, theirs, strict=True):
            if b is not None:
                assert_same(a, b, path)
    elif np.asarray(theirs).dtype == bool:
        np.testing.assert_array_equal(ours, theirs, err_msg=path)
    else:
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6, err_msg=path)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("seed", [5, [3, None, 9]])
def test_a_vector_is_what_gymnasium_makes_of_single_environments(short, mode, seed):
    """Falling, cut and both, over several episodes; the same seeds, and so the same starts."""
    with_metrics = Scored(short)
    ours = envs.as_gymnasium_vector(with_metrics, 3, mode.value)
    single = [envs.as_gymnasium(with_metrics) for _ in range(3)]
    theirs = SyncVectorEnv([lambda env=env: env for env in single], autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == mode
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    assert_same(ours.reset(seed=0), theirs.reset(seed=0))
    assert_same(ours.reset(seed=seed), theirs.reset(seed=seed))
    fallen = cut = 0
    for _ in range(25):
        actions = np.array([[3.0], [0.0], [-1.5]], np.float32)
        stepped = ours.step(actions)
        assert_same(stepped, theirs.step(actions))
        fallen, cut = fallen + stepped[2], cut + stepped[3]
        ended = stepped[2] | stepped[3]
        if mode == AutoresetMode.DISABLED and ended.any():
            with pytest.raises(gymnasium.error.ResetNeeded, match=str(np.flatnonzero(ended).tolist()[0])):
                ours.step(actions)
            mask = lambda ended=ended: {"reset_mask": ended.copy()}  # noqa: E731  (theirs takes it out)
            assert_same(ours.reset(options=mask()), theirs.reset(options=mask()))
    assert fallen[0] >= 2 and cut[1] >= 2 and not fallen[1]


class Scored(envs.Wrapper):
    """With a part of the reward, which the pendulum has not."""

    def reset(self, key):
        state = self._env.reset(key)
        return state.replace(metrics={"angle": jax.numpy.zeros((), state.obs.dtype)})

    def step(self, state, action):
        after = self._env.step(state, action)
        return after.replace(metrics={"angle": after.obs[1]})


def test_what_a_vector_refuses(short):
    with pytest.raises(ValueError, match="at least 1 copy, got 0"):
        envs.as_gymnasium_vector(short, 0)
    with pytest.raises(ValueError, match="'never' is not a valid AutoresetMode"):
        envs.as_gymnasium_vector(short, 1, "never")
    vector = envs.as_gymnasium_vector(short, 2)
    with pytest.raises(ValueError, match="2 copies want as many seeds, got 3"):
        vector.reset(seed=[1, 2, 3])
    vector.reset(seed=0)
    for mask, message in (
        ([True], r"shape \(2,\)"),
        (np.ones(2, int), "bool array"),
        (np.zeros(2, bool), "nothing"),
    ):
        with pytest.raises(ValueError, match=message):
            vector.reset(options={"reset_mask": mask})


def test_nothing_is_registered():
    before = set(gymnasium.registry)
    envs.as_gymnasium(small.env("InvertedPendulum"))
    assert set(gymnasium.registry) == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what Stable-Baselines3 imports
@pytest.mark.parametrize("make", [lambda: small.env("SkewedPendulum"), grounded, corrected])
def test_stable_baselines3_trains_in_it(make):
    """Falling takes a random policy some ten steps."""
    torch = pytest.importorskip("torch")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env as check
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor

    torch.set_num_threads(1)  # small networks: threads wait for each other
    env = envs.as_gymnasium(make())
    check(env, warn=False)
    learner = PPO(
        "MlpPolicy", env, n_steps=256, batch_size=64, gamma=0.95, learning_rate=2e-3, seed=0, device="cpu"
    )
    returns = []
    for steps in (0, 3072):
        if steps:
            learner.learn(steps)
        returns.append(evaluate_policy(learner, Monitor(env), n_eval_episodes=5)[0])
    assert returns[0] < 40 < returns[1] and returns[1] > 1.5 * returns[0], returns
