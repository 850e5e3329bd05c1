"""Parts of recordings, each predicted from the others."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.evidence.folds import FOLDS, folds


@pytest.mark.parametrize("count", [3, 4, 12])
def test_of_several_recordings_a_part_holds_whole_ones(count):
    # some come a second time, as the part of them that chose
    recording = np.concatenate([np.repeat(np.arange(count), 4), np.repeat(np.arange(count), 2)])
    fold = folds(recording, np.zeros(recording.size))
    assert len(np.unique(fold)) == min(count, FOLDS)
    for k in range(count):
        assert len(np.unique(fold[recording == k])) == 1


@pytest.mark.parametrize("count", [1, 2])
def test_few_recordings_are_cut_into_stretches_of_time(count):
    recording, start = np.arange(20) % count, np.random.default_rng(0).permutation(20).astype(float)
    fold = folds(recording, start)
    assert np.bincount(fold).tolist() == [4] * FOLDS
    order = np.lexsort((start, recording))
    assert (np.diff(fold[order]) >= 0).all()


def test_names_of_recordings_need_not_be_in_a_row():
    assert folds(np.array([7, 3, 3, 90]), np.zeros(4)).tolist() == [1, 0, 0, 2]


def test_nothing_has_no_parts():
    assert folds(np.zeros(0, int), np.zeros(0)).size == 0
