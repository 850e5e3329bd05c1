"""Terms that are taken away after a search."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.evidence.scored import Scored
from mpge_jax.diagnosis.selection import all_joints, backward_elimination
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, fitted, slight

TERMS, WINDOWS = (COULOMB, DAMPING, GAIN, ARMATURE), 60


@pytest.mark.parametrize(
    ("module", "taken_away", "least"),
    [(backward_elimination, backward_elimination.prune, 1), (all_joints, all_joints._thinned, 0)],
    ids=["one by one", "by halves"],
)
@pytest.mark.parametrize("helps", [True, False], ids=["each helps a little", "none helps"])
def test_what_many_explain_a_little_is_not_given_up_one_by_one(
    rubbing, monkeypatch, module, taken_away, least, helps
):
    s, _ = rubbing
    shares = helps * slight(len(TERMS), WINDOWS)

    def scored(f):
        missed = [shares[k] for k, t in enumerate(TERMS) if t not in f.hypothesis.terms]
        return Scored(f, np.zeros(0), 100.0 + np.sum(missed, axis=0) + np.zeros(WINDOWS), 1, 0)

    monkeypatch.setattr(s, "score", lambda fits, whites: [scored(f) for f in fits])
    monkeypatch.setattr(s, "whiten", lambda f: (None, None))
    for name, stub in (
        ("fit", lambda sim, fits, *rest, **settings: fits),
        ("slopes_of", lambda *_: {}),
        ("moves", lambda s, new, old: True),
        ("strength", lambda s, f: {t: float(TERMS.index(t)) / 10 for t in f.hypothesis.terms}),
    ):
        monkeypatch.setattr(module, name, stub, raising=False)
    found = taken_away(s, fitted(s, {t: [0.1] for t in TERMS}))
    assert len(found.hypothesis.terms) == (3 if helps else least)
