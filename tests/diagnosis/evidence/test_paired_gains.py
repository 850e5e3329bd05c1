"""What gains of windows say: balance, ranks, what stands out, and ties."""

from __future__ import annotations

import dataclasses

import numpy as np

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.paired_gains import deviations, rare, stand_out, strong
from mpge_jax.diagnosis.evidence.scored import Scored, clearly_worse, hopeful
from mpge_jax.diagnosis.selection.criteria import needed
from tests.diagnosis.searches import ARMATURE, COULOMB, GAIN, HINGE, MOTOR, STRIBECK, fitted


def test_an_effect_that_acts_in_few_windows_is_evidence():
    gain = np.zeros(40)
    gain[:5] = [18.7, 18.2, 11.6, 2.3, 1.6]
    assert deviations(gain) < 3 and strong(gain, gain)


def test_one_window_is_no_evidence_and_neither_is_chaos():
    one, chaos = np.zeros(40), np.zeros(40)
    one[0] = 40.0
    chaos[:8] = [20, 15, 10, 5, -4, -6, -8, -3]
    assert not strong(one, one) and not strong(chaos, chaos)


def test_windows_that_stand_out_of_the_noise_are_evidence_for_what_acts_rarely():
    noise = 1.0 + 0.06 * np.random.default_rng(0).standard_normal(77)
    worse = noise.copy()
    worse[[3, 39, 60]] = [2.4, 2.7, 3.0]
    assert set(np.flatnonzero(stand_out(worse))) == {3, 39, 60} and not stand_out(noise).any()
    assert deviations(worse - noise) < 3 and rare(worse, noise, fitted=40)
    # nothing that was not fitted is explained, one of three only, or others are spoiled instead
    assert not rare(worse, np.where(np.arange(77) < 40, noise, worse), fitted=40)
    assert not rare(worse, np.where(np.arange(77) == 60, noise, worse), fitted=40)
    assert not rare(worse, noise + 2.0 * (np.arange(77) % 20 == 5), fitted=40)
    # where much is missing everywhere, large losses are nothing special
    assert not stand_out(5.0 * worse).any() and not rare(5.0 * worse, 5.0 * noise, fitted=40)
    # nor are small ones, or those of a noise that was overestimated
    hardly = np.where(worse > 2, 1.3, 1.0 + 0.001 * noise)
    assert not rare(hardly, np.ones(77), fitted=40) and not rare(0.1 * worse, 0.1 * noise, fitted=40)


def test_what_stands_out_of_a_noise_that_was_enlarged_is_no_evidence(null):
    s, _ = null
    worse = 1.0 + 0.06 * np.random.default_rng(0).standard_normal(77)
    better = worse.copy()
    worse[[3, 39, 60]] = [2.4, 2.7, 3.0]
    old = Scored(NOTHING, worse[:40], worse[40:], 0, 0)
    new = Scored(fitted(s, {COULOMB: [0.1]}), better[:40], better[40:], 1, 1)
    assert needed(new, old) and clearly_worse(old, new)
    tempered = dataclasses.replace(new, factor=3.0)
    assert not needed(tempered, old) and not clearly_worse(old, tempered)


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


def test_ranks_see_what_spoiled_windows_blur():
    rng = np.random.default_rng(0)
    gain = np.concatenate([rng.uniform(0.1, 0.6, 45), rng.uniform(-0.4, 0, 10), [5, -5, 6, -6, 7, -7]])
    mean = gain.mean() / (gain.std(ddof=1) / np.sqrt(gain.size))
    assert mean < 1.0 and deviations(gain) > 3.0
