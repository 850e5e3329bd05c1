"""Policies as orbax checkpoints: in full precision, ready to act, and refused in one sentence where damaged."""

import json
import shutil

import jax
import numpy as np
import pytest

from mpge_jax.learning import sac
from mpge_jax.rollouts import policies
from tests import small


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "policy"
    policies.save_checkpoint(folder, small.policy_set(size=2))
    return folder


def test_a_set_comes_back_to_the_bit_and_acts(saved):
    chosen = small.policy_set(size=2)
    jax.tree.map(np.testing.assert_array_equal, policies.load_checkpoint(saved), chosen)
    observation = np.array([0.1, -0.2, 0.3, 0.4])
    actor = jax.tree.map(lambda x: x[1], chosen.actor)
    expected = sac.act(actor, jax.numpy.asarray(observation, "float32"))
    np.testing.assert_allclose(policies.controller(saved, 1)(observation), expected, rtol=1e-6)
    # In place of what was there.
    policies.save_checkpoint(saved, chosen)
    with pytest.raises(ValueError, match="this set has 0 to 1"):
        policies.controller(saved, 2)


def _emptied(folder):
    for file in folder.rglob("*"):
        if file.is_file():
            file.write_bytes(b"")


def _foreign(folder):
    import orbax.checkpoint as ocp

    shutil.rmtree(folder)
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(folder, {"weights": np.zeros(3)})


def _pickled(folder):
    shutil.rmtree(folder)
    folder.mkdir()
    (folder / "policy.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")


def _escaping(folder):
    """Metadata that name a file elsewhere."""
    (folder / "_METADATA").write_text(json.dumps({"tree_metadata": {"../../x": {}}, "use_ocdbt": False}))


@pytest.mark.parametrize("damage", [_emptied, _foreign, _pickled, _escaping])
def test_a_damaged_or_foreign_checkpoint_is_one_sentence(saved, tmp_path, damage):
    folder = tmp_path / "policy"
    shutil.copytree(saved, folder)
    damage(folder)
    with pytest.raises(ValueError, match="is damaged or is no checkpoint of policies") as caught:
        policies.load_checkpoint(folder)
    assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError, match="there is no checkpoint of policies at"):
        policies.load_checkpoint(tmp_path / "nowhere")
