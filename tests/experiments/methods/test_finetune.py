"""SAC that goes on in the target: how many steps, whose, and what is learned from them."""

import numpy as np
import pytest

from experiments.methods import METHODS, training
from tests.experiments.tiny import assert_moves_like, work


@pytest.mark.parametrize("samples", [11, 40])
def test_finetuning_takes_exactly_the_metered_steps_in_the_target(monkeypatch, tmp_path, samples):
    ended = []
    run = training.loop.run
    monkeypatch.setattr(
        training.loop, "run", lambda *a, **k: ended.append(run(*a, **k)[0]) or (ended[-1], {})
    )
    given = work("finetune", tmp_path, samples=samples)
    made = METHODS["finetune"].work(given)
    (state,) = ended
    assert made.target_steps == [samples] == list(np.asarray(state.buffer.size))
    assert_moves_like(state, 1.5)
    # A batch of 8 or half of the budget is recorded first, by the policy, without learning from it.
    first = min(8, samples // 2)
    assert int(state.learner.step[0]) == samples - first
    spread = np.exp(np.asarray(given.sets.actor.params["params"]["Dense_1"]["bias"])[0, 0, 1])
    actions = np.arctanh(np.asarray(state.buffer.rows)[0, :first, 4] / 3.0)
    assert np.abs(actions + 0.6).max() < 6 * spread
