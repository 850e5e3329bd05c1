"""Terms that are taken away after a search."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import default_places, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.scored import Scored
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection import all_joints, backward_elimination
from mpge_jax.diagnosis.selection.backward_elimination import as_wide_as_integrators_differ, final_fit
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, fitted, search_of, slight

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


@pytest.mark.parametrize(("rotors", "tried"), [(3, {"armature@j2", "viscous_damping@j0"}), (2, None)])
def test_what_other_joints_have_too_stays_where_it_differs_clearly_from_nothing(rotors, tried, monkeypatch):
    """Evidence against each by itself is little where something else passes for all of them."""
    bodies = "".join(
        f'<body pos="0 0 -.3"><joint name="j{k}" axis="0 1 0"/><geom size=".05" pos="0 0 -.2"/>'
        for k in range(3)
    )
    xml = f"<mujoco><worldbody>{bodies}{'</body>' * 3}</worldbody></mujoco>"
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    joints = default_places(ctx, "joint")
    parts = {Term("armature", j): np.array([0.01]) for j in joints[:rotors]}
    parts[Term("viscous_damping", joints[0])] = np.array([0.1])
    h = Hypothesis.of(*parts)
    theta = h.gather(ctx, parts)
    strengths = dict(zip(parts, (9.0, 6.0, *([3.0] if rotors == 3 else []), 1.0), strict=True))
    monkeypatch.setattr(backward_elimination, "strength", lambda *_: strengths)
    s = SimpleNamespace(sim=SimpleNamespace(ctx=ctx), terms=[])
    fewer = backward_elimination._simpler(s, Fitted(h, theta, theta))
    gone = {str(t) for f in fewer for t in set(h.terms) - set(f.hypothesis.terms)}
    assert gone == (tried or {str(t) for t in h.terms})


def test_what_becomes_likely_as_the_rest_is_fitted_stays(rubbing, monkeypatch):
    """Then nothing is left that could be taken away."""
    s, _ = rubbing
    current = fitted(s, {COULOMB: [0.1], DAMPING: [0.01]})
    looks = iter([[current], []])
    monkeypatch.setattr(backward_elimination, "_simpler", lambda *_: next(looks))
    assert backward_elimination.prune(s, current).hypothesis == current.hypothesis


def test_rotor_inertia_is_told_no_better_than_a_servo_brakes_within_a_step():
    """MuJoCo's implicit steps add h kv to the inertia, for explicit ones: half of that is a deviation."""
    s, _ = search_of(FINE_ARM, record(FINE_ARM, 0.8, change=lambda m: m.dof_armature.__setitem__(1, 0.01)))
    (rotor,) = (t for t in s.terms if str(t) == "armature@elbow")
    f, _ = final_fit(s, fitted(s, {rotor: [0.005]}))
    wide = as_wide_as_integrators_differ(s, f, s.train)
    deviation, before = (float(np.sqrt(x.cov[0, 0])) for x in (wide, f))
    assert (
        deviation == pytest.approx(np.hypot(before, 0.5 * 0.002 * 0.4), rel=0.15) and deviation > 2 * before
    )
    np.testing.assert_array_equal(wide.theta, f.theta)
