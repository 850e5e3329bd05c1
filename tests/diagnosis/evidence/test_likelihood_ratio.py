"""What gains of windows say: one likelihood ratio, for what is needed and what ties; ranks; what stands out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.likelihood_ratio import (
    SURE,
    beyond_doubt,
    deviations,
    log_ratio,
    odds,
    stand_out,
)
from mpge_jax.diagnosis.evidence.scored import (
    Scored,
    clearly_worse,
    held_out_evidence,
    hopeful,
    with_simpler,
)
from mpge_jax.diagnosis.selection.criteria import needed
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, HINGE, MOTOR, STRIBECK, fitted


def test_the_log_ratio_is_twice_the_squared_deviations():
    gain = np.array([30.0, 10.0, 50.0, 20.0, -10.0])
    mean, error = 20.0, np.sqrt((100 + 100 + 900 + 0 + 900) / 4 / 5)
    by_rank = (4.0 + 1.5 + 5.0 + 3.0 - 1.5) / np.sqrt(16 + 2.25 + 25 + 9 + 2.25)
    assert log_ratio(gain) == pytest.approx(2.0 * max(mean / error, by_rank) ** 2)
    assert log_ratio(-gain) == pytest.approx(-log_ratio(gain))


def test_what_is_slight_in_all_is_no_evidence_however_regular():
    assert log_ratio(np.array([1.0, 1.1, 0.9, 1.0])) == pytest.approx(2.0)
    assert log_ratio(np.array([[0.75, 0.25], [0.5, 0.6], [0.4, 0.5], [1.0, 0.0]])) == pytest.approx(2.0)
    assert log_ratio(-np.array([1.0, 1.1, 0.9, 1.0])) == pytest.approx(-2.0)
    assert log_ratio(np.array([2.0, 2.2, 1.8, 2.0])) > 1000.0
    assert log_ratio(np.zeros(5)) == 0.0


def test_odds_in_words():
    assert odds(np.log(20.0)) == "odds of 20 to 1"
    assert odds(np.log(12_345.0)) == "odds of 12,345 to 1"
    assert odds(50.0) == "odds of more than a million to 1"


@pytest.mark.parametrize("shift", [0.2, 0.5])
def test_two_hypotheses_on_plain_noise_have_the_ratio_of_their_likelihoods(shift):
    """Of N(shift, 1) to N(0, 1), from what the former gives: in the middle of many draws, by scatter alone."""
    x = shift + np.random.default_rng(0).standard_normal((4000, 200))
    gains = x**2 - (x - shift) ** 2
    expected = 200 * shift**2 / 2
    # gains of another size scatter as much: half their sum is no bound then
    assert np.median([log_ratio(1e6 * g) for g in gains]) == pytest.approx(expected, rel=0.2)


def test_noise_is_taken_for_an_effect_as_seldom_as_the_ratio_says():
    """A hypothesis that is chosen among forty, fitted to windows of its own: of nothing but noise."""
    rng, accepted = np.random.default_rng(1), 0
    for _ in range(400):
        train, held = rng.standard_normal((2, 40, 60))
        shift = train.mean(1, keepdims=True)
        gains = held**2 - (held - shift) ** 2
        accepted += max(map(log_ratio, gains)) > SURE + np.log(40)
    assert accepted <= 400 / 20


def test_an_effect_that_acts_in_few_windows_is_evidence():
    gain = np.zeros(40)
    gain[:5] = [18.7, 18.2, 11.6, 2.3, 1.6]
    assert log_ratio(gain) > SURE


def test_a_mean_in_doubt_is_not_outvoted_by_ranks():
    """Few windows in which something slips, and many in which next to nothing differs: neither may be sure."""
    gain = np.full(40, -0.1) * np.linspace(1.0, 2.0, 40)
    gain[:2] = [40.0, 20.0]
    assert 0.0 < log_ratio(gain) < SURE < 2.0 * deviations(-gain) ** 2


def test_one_window_is_no_evidence_and_neither_is_chaos():
    one, chaos = np.zeros(40), np.zeros(40)
    one[0] = 40.0
    chaos[:8] = [20, 15, 10, 5, -4, -6, -8, -3]
    assert log_ratio(one) < SURE and log_ratio(chaos) < SURE


def test_windows_that_stand_out_of_the_noise():
    noise = 1.0 + 0.06 * np.random.default_rng(0).standard_normal(77)
    worse = noise.copy()
    worse[[3, 39, 60]] = [2.4, 2.7, 3.0]
    assert set(np.flatnonzero(stand_out(worse))) == {3, 39, 60} and not stand_out(noise).any()
    # where much is missing everywhere, large losses are nothing special
    assert not stand_out(5.0 * worse).any()
    # nor are small ones, or those of a noise that was overestimated
    assert not stand_out(np.where(worse > 2, 1.3, 1.0 + 0.001 * noise)).any()
    assert not stand_out(0.1 * worse).any()


def _scored(s, loss, terms=()):
    """Twenty windows, of which the second half was fitted to by nothing, all with a loss."""
    f = fitted(s, {COULOMB: [0.1]}) if terms else NOTHING
    return Scored(f, np.full(10, loss), np.full(10, loss), len(terms), len(terms))


def test_one_statistic_says_what_is_needed_and_what_ties(null):
    s, _ = null
    new = _scored(s, 1.0, (COULOMB,))
    # ten held-out windows; twenty where all count
    assert held_out_evidence(new, _scored(s, 1.5)) == pytest.approx(2.5)
    assert needed(new, _scored(s, 1.7)) and not needed(new, _scored(s, 1.5))
    assert clearly_worse(_scored(s, 1.4), new) and not clearly_worse(_scored(s, 1.2), new)
    # where more is left than noise, scatter alone tells
    new, old = dataclasses.replace(new, factor=2.0), _scored(s, 3.0)
    old.held[:] = [9.0, -5.0, 3.0, 8.0, -1.0, 6.0, 2.0, 7.0, -3.0, 4.0]
    ratio = held_out_evidence(new, old)
    assert ratio == pytest.approx(log_ratio(old.held - 1.0))
    assert needed(new, old, among=1) and not needed(new, old, among=int(np.exp(ratio - SURE)) + 1)


def test_what_was_the_best_of_many_must_win_by_more():
    """20 to 1, and as many times more as there were others to choose from: for two effects, pairs of them."""
    assert beyond_doubt(3.1) and not beyond_doubt(2.9)
    assert beyond_doubt(6.1, among=20) and not beyond_doubt(5.9, among=20)
    assert beyond_doubt(9.1, among=20, effects=2) and not beyond_doubt(8.9, among=20, effects=2)
    assert beyond_doubt(3.1, among=0)


def test_each_joint_of_a_window_tells(null):
    s, _ = null
    each = np.ones((20, 6))
    each[:, 4] = 1.7
    old = dataclasses.replace(_scored(s, 1.0 + 0.7 / 6), each=each)
    new = dataclasses.replace(_scored(s, 1.0, (COULOMB,)), each=np.ones((20, 6)))
    assert needed(new, old)
    together = [dataclasses.replace(x, each=np.zeros((0, 0))) for x in (new, old)]
    assert not needed(*together)


def _guess(loss: float, *terms: Term) -> Fitted:
    return Fitted(Hypothesis.of(*terms), np.zeros(0), np.zeros(0), loss)


def test_laws_of_friction_at_one_joint_do_not_crowd_out_what_else_is_hopeful():
    load = Term("load_dependent_friction", HINGE)
    fits = [
        _guess(x, t) for x, t in ((1.0, STRIBECK), (1.1, load), (2.9, COULOMB), (2.8, GAIN), (2.95, ARMATURE))
    ]
    delay, tilt = Term("actuator_delay", MOTOR), Term("gravity_tilt", Place("world", "world", 0))
    fits += [_guess(2.96, delay), _guess(2.97, tilt)]
    # half of what the best takes away, three families, and the plain law of an elaborate one
    kept = [f.hypothesis.terms[0] for f in hopeful(fits, before=3.0)]
    assert kept == [STRIBECK, load, GAIN, COULOMB, ARMATURE]
    assert hopeful([], before=3.0) == []


def test_what_was_found_before_keeps_no_candidate():
    """The plain law of an elaborate one that is a candidate stays; friction that all have says nothing of any."""
    found, bias = (STRIBECK, DAMPING), Term("actuator_bias", MOTOR)
    fits = [_guess(1.0, *found, GAIN), _guess(1.1, *found, ARMATURE), _guess(1.2, *found, bias)]
    assert with_simpler(fits, 1) == fits[:1]
    plain = _guess(1.2, COULOMB, GAIN)
    assert with_simpler([_guess(1.0, STRIBECK, GAIN), _guess(1.1, ARMATURE, GAIN), plain], 1)[1:] == [plain]
    assert with_simpler([], 1) == []


def test_ranks_see_what_spoiled_windows_blur():
    rng = np.random.default_rng(0)
    gain = np.concatenate([rng.uniform(0.1, 0.6, 45), rng.uniform(-0.4, 0, 10), [5, -5, 6, -6, 7, -7]])
    mean = gain.mean() / (gain.std(ddof=1) / np.sqrt(gain.size))
    assert mean < 1.0 and deviations(gain) > 3.0


QUIET = 0.9 + 0.05 * np.random.default_rng(0).standard_normal((2, 40))


def _saturating(null, factor=1.0, each=None, new=QUIET[0]) -> tuple[Scored, Scored]:
    """A hypothesis that explains two windows of forty, and one that does not; `each`: losses of its joints."""
    s, _ = null
    old = QUIET[1].copy()
    old[[13, 27]] = 14.0
    joints = np.zeros((0, 0)) if each is None else each
    before = np.zeros((0, 0)) if each is None else each + (old - QUIET[1])[:, None]
    better = Scored(fitted(s, {COULOMB: [0.1]}), new[:10], new[10:], 1, 1, factor, joints)
    return better, Scored(NOTHING, old[:10], old[10:], 0, 0, factor, before)


def test_few_windows_decide_where_the_better_hypothesis_leaves_nothing_but_noise(null):
    better, worse = _saturating(null)
    assert better.noise_alone and not worse.noise_alone
    assert needed(better, worse, among=100)
    assert not beyond_doubt(log_ratio((worse.losses - better.losses)[10:]), among=100)
    assert held_out_evidence(worse, better) == -held_out_evidence(better, worse)


def _outlier() -> np.ndarray:
    new = QUIET[0].copy()
    new[5] = 5.0
    return new


@pytest.mark.parametrize(
    ("what", "settings"),
    [
        ("the noise is enlarged to what is left", {"factor": 2.0}),
        ("more is left than noise", {"new": QUIET[0] + 0.24}),
        ("a window stands out", {"new": _outlier()}),
        (
            "one joint of many leaves more",
            {"each": np.where(np.arange(7) == 2, 1.9, 0.9) + np.zeros((40, 1))},
        ),
    ],
)
def test_else_few_windows_are_little_evidence(null, what, settings):
    better, worse = _saturating(null, **settings)
    assert not better.noise_alone
    assert not needed(better, worse, among=100)
