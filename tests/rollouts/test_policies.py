"""Sets of rollout policies: selection, warm starts, files."""

import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax import files
from mpge_jax.learning import sac
from mpge_jax.learning.sac import SACConfig
from mpge_jax.rollouts import policies
from tests import small


def test_a_selection_keeps_its_order_and_may_repeat():
    chosen = small.policy_set().select([2, 0, 2])
    np.testing.assert_array_equal(
        chosen.actor.params["params"]["Dense_1"]["bias"],
        np.asarray(small.policy_set().actor.params["params"]["Dense_1"]["bias"])[[2, 0, 2]],
    )
    assert chosen.size == 3 and chosen.hidden == (8,)


@pytest.mark.parametrize("index", [3, -1])
def test_a_policy_that_is_not_there_is_refused(index):
    with pytest.raises(ValueError, match="this set has 0 to 2"):
        small.policy_set().select([0, index])


def test_a_learner_goes_on_from_its_policy():
    learner = small.policy_set().learner(1, small.SAC)
    expected = jax.tree.map(lambda x: x[1], small.policy_set())
    jax.tree.map(np.testing.assert_array_equal, learner.actor, expected.actor)
    jax.tree.map(np.testing.assert_array_equal, learner.critic, expected.critic)
    jax.tree.map(np.testing.assert_array_equal, learner.target_critic, expected.critic)
    assert float(learner.log_alpha) == float(expected.log_alpha)


def test_a_learner_of_other_networks_is_refused():
    with pytest.raises(ValueError, match=r"hidden layers \(8,\), the configuration wants \(256, 256\)"):
        small.policy_set().learner(0, SACConfig())


def test_mean_entropy_by_hand():
    # Gaussian entropy: log_std + (1 + log 2 pi) / 2; the spreads of the set are -1, -0.9, -0.8.
    rest = 0.5 * (1.0 + np.log(2.0 * np.pi))
    obs = jnp.array([0.1, -0.2, 0.3, 0.0])
    for weights, expected in (([1, 0, 0], -1.0), ([1, 1, 0], -0.95), ([0, 1, 1], -0.85)):
        found = policies.mean_entropy(small.policy_set(), jnp.array(weights, jnp.float32), obs)
        np.testing.assert_allclose(found, expected + rest, rtol=1e-5)
    assert float(policies.mean_entropy(small.policy_set(), jnp.zeros(3), obs)) == 0.0


def test_files_keep_half_precision_and_no_pickle(tmp_path):
    path = tmp_path / "sub" / "set.npz"
    policies.save(path, small.policy_set(), {"task": "InvertedPendulum", "returns": [1.5]})
    with np.load(path, allow_pickle=False) as file:
        kinds = {name: file[name].dtype for name in file.files}
    assert kinds.pop("about").kind == "U"
    assert kinds.pop("log_alpha") == kinds.pop("action_scale") == kinds.pop("action_middle") == np.float32
    assert set(kinds.values()) == {np.dtype(np.float16)}
    loaded, about = policies.load(path)
    assert about == {"task": "InvertedPendulum", "returns": [1.5]}
    assert jax.tree.structure(loaded) == jax.tree.structure(small.policy_set())
    jax.tree.map(
        lambda a, b: np.testing.assert_array_equal(a, np.asarray(b, np.float16).astype(np.float32)),
        (loaded.actor.params, loaded.critic),
        (small.policy_set().actor.params, small.policy_set().critic),
    )
    np.testing.assert_array_equal(loaded.log_alpha, small.policy_set().log_alpha)
    assert [p.name for p in path.parent.iterdir()] == ["set.npz"]


def test_the_middle_of_the_action_box_is_kept_and_0_in_older_files(tmp_path):
    made = small.policy_set()
    middle = jnp.full_like(made.actor.action_middle, 0.3)
    made = made.replace(actor=made.actor.replace(action_middle=middle))
    policies.save(tmp_path / "set.npz", made, {})
    policies.save_checkpoint(tmp_path / "set", made)
    for loaded in (policies.load(tmp_path / "set.npz")[0], policies.load_checkpoint(tmp_path / "set")):
        np.testing.assert_array_equal(loaded.actor.action_middle, middle)
    with np.load(tmp_path / "set.npz") as file:
        np.savez(tmp_path / "old.npz", **{n: file[n] for n in file.files if n != "action_middle"})
    np.testing.assert_array_equal(policies.load(tmp_path / "old.npz")[0].actor.action_middle, 0 * middle)


def rewritten(path, **changes):
    with np.load(path) as file:
        fields = {name: file[name] for name in file.files}
    np.savez(path, **{**fields, **changes})


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:300]),
        lambda path: path.write_text("no set"),
        lambda path: rewritten(path, about=np.array("{")),
        lambda path: rewritten(path, log_alpha=np.zeros(2, np.float32)),
        lambda path: rewritten(path, log_alpha=np.array([0.0, np.nan, 0.0], np.float32)),
        lambda path: rewritten(path, log_alpha=np.array([None, None, None])),
        lambda path: np.savez(path, x=np.zeros(3)),
    ],
    ids=["truncated", "text", "account", "number of policies", "nan", "pickle", "fields"],
)
def test_a_damaged_file_is_named_in_one_sentence(tmp_path, damage):
    path = tmp_path / "set.npz"
    policies.save(path, small.policy_set(), {})
    damage(path)
    with pytest.raises(ValueError, match=r"set\.npz is damaged or is not a policy set") as error:
        policies.load(path)
    assert "\n" not in str(error.value)


def test_a_set_that_would_fill_the_memory_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "set.npz"
    files.write_npz(path, {"about": np.array("{}"), "log_alpha": np.zeros(8 << 20)})
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(files, "MOST_BYTES", 1 << 20)
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"unpacked it would have 0\.0671 GB"):
        policies.load(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 4e6


def test_a_missing_set_says_how_to_make_one(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"python -m experiments\.pretrain"):
        policies.load(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="unknown environment 'Pendulum'"):
        policies.shipped("Pendulum", "MS")
    with pytest.raises(ValueError, match=r"SkewedPendulum is a target; .* its source, InvertedPendulum"):
        policies.shipped("SkewedPendulum", "MS")
    with pytest.raises(
        FileNotFoundError, match=r"pretrain --task Hopper --kind ER --entropy-coefficient 0\.5`"
    ):
        policies.shipped("Hopper", "ER", 0.5)
    with pytest.raises(ValueError, match="unknown kind of policy set 'XY'"):
        policies.shipped("InvertedPendulum", "XY")


@pytest.mark.parametrize(
    "path", sorted(policies.shipped_path("x", "MS").parent.glob("*.npz")), ids=lambda p: p.stem
)
def test_every_shipped_set_loads_and_says_where_it_comes_from(path):
    task, kind, *coefficient = path.stem.split("-")
    loaded, about = policies.shipped(task, kind, *map(float, coefficient))
    assert (about["task"], about["kind"], loaded.size) == (task, kind, 5)
    expected = float(coefficient[0]) if coefficient else 0.1
    assert about["entropy_coefficient"] == (expected if kind == "ER" else 0.0)
    assert len(about["returns"]["stochastic"]) == 5
    env = small.env(task)
    loaded.rollout.check_fits(env)
    assert loaded.hidden == SACConfig().hidden
    np.testing.assert_array_equal(loaded.actor.action_scale, np.tile(env.action_high, (5, 1)))
    action = jax.vmap(lambda actor: sac.act(actor, jnp.zeros(env.observation_size)))(loaded.actor)
    assert np.all(np.abs(action) <= env.action_high[None])
    # Five policies, not one five times.
    kernels = np.asarray(loaded.actor.params["params"]["Dense_0"]["kernel"]).reshape(5, -1)
    assert len(np.unique(kernels, axis=0)) == 5
