"""Which recordings train, choose and test."""

import numpy as np
import pytest

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.three_parts import three_parts


def runs(*names: str, rows: int = 121) -> list[Recording]:
    return [Recording(name, 0.1 * np.arange(rows), np.zeros((rows, 1))) for name in names]


def names(recordings, held_out=None, seed=0):
    x = three_parts(recordings, held_out, np.random.default_rng(seed))
    return tuple([r.name for r in part] for part in (x.train, x.choice, x.test))


def test_named_recordings_test_and_the_last_third_of_each_other_chooses():
    many = runs("a", "heldout_b", "c", "d", "heldout_e")
    assert names(many) == (["a", "c", "d"], ["a_choice", "c_choice", "d_choice"], ["heldout_b", "heldout_e"])
    assert names(many, ("c",))[2] == names(many, ("logs/c.npz",))[2] == ["c"]
    with pytest.raises(InputError, match="'x' is not among a, heldout_b, c"):
        names(many, ("x",))
    with pytest.raises(InputError, match="every recording is held out"):
        names(runs("heldout_a"))


def test_without_names_a_seeded_quarter_tests_and_of_short_ones_a_third_of_the_others_chooses():
    twelve = runs(*"abcdefghijkl", rows=31)
    train, choice, test = names(twelve)
    assert (len(train), len(choice), len(test)) == (6, 3, 3)
    assert sorted(train + choice + test) == list("abcdefghijkl")
    assert names(twelve) == names(twelve) and len({tuple(names(twelve, seed=k)[2]) for k in range(5)}) > 1


def test_parts_are_shares_of_the_time_recorded_however_unequal_recordings_are():
    rows = [102, 5, 5, 6, 6, 8, 21, 6, 5, 94, 10, 24, 63, 12, 40, 5, 5, 6, 7, 102]
    recordings = [r for k, n in enumerate(rows) for r in runs(f"r{k}", rows=n)]
    for seed in range(8):
        x = three_parts(recordings, None, np.random.default_rng(seed))
        lasts = np.array([sum(r.duration for r in part) for part in (x.train, x.choice, x.test)])
        np.testing.assert_allclose(lasts / lasts.sum(), (1 / 2, 1 / 4, 1 / 4), atol=0.06)
    # one that lasts longer than all others together trains
    train, choice, test = names([*runs("long", rows=41), *runs(*"abcdef", rows=6)])
    assert "long" in train and choice and test


@pytest.mark.parametrize(("count", "said"), [(1, "only one recording"), (3, "few recordings")])
def test_of_few_recordings_the_last_stretches_are_set_apart(count, said):
    x = three_parts(runs(*"abc"[:count]), None, np.random.default_rng(0))
    assert said in x.warnings[0] and "quarter" in x.warnings[0]
    assert [r.name for r in x.test] == [f"{r}_test" for r in "abc"[:count]]
    assert all(r.before == pytest.approx(9.0) and r.time[-1] == 12.0 for r in x.test)
    ends = [(r.name, r.time[0] + r.before, r.time[-1]) for r in (*x.train, *x.choice)]
    assert [n for n, *_ in ends] == [*"abc"[:count], *(f"{r}_choice" for r in "abc"[:count])]
    spans = [[0, 6]] * count + [[6, 9]] * count
    np.testing.assert_allclose([t for _, *t in ends], spans, atol=0.11)


def test_what_is_too_short_to_divide_is_said():
    with pytest.raises(InputError, match="a has only 5 rows; record more"):
        three_parts(runs("a", rows=5), None, np.random.default_rng(0))
