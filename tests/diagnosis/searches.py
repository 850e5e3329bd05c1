"""Searches on small machines, and fits of given values, for several rooms' tests."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY, Config, Recording, pipeline
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.simulation.single_step import Machine

HINGE, MOTOR = Place("joint", "hinge", 0), Place("actuator", "motor", 0)
COULOMB, STRIBECK = Term("coulomb_friction", HINGE), Term("stribeck_friction", HINGE)


DAMPING, GAIN = Term("viscous_damping", HINGE), Term("actuator_gain", MOTOR)
ARMATURE = Term("armature", HINGE)

MISTAKEN_FOR_FRICTION = (
    "viscous_damping", "stribeck_friction", "quadratic_drag", "armature", "actuator_deadzone", "mass_scale",
)  # fmt: skip
"""Where the rest of the vocabulary only takes time."""


def look_for_nothing_beside(patch: pytest.MonkeyPatch) -> None:
    """What has no name is left as it is: nothing is looked for beside it."""
    patch.setattr(pipeline, "beside_unknown", lambda _p, _s, found, held, _say: (found, held))


def prepared_of(xml: str, recordings: list[Recording]) -> Prepared:
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    return prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))


def search_of(xml: str, recordings: list[Recording]) -> tuple[Search, Prepared]:
    p = prepared_of(xml, recordings)
    return build_search(p, lambda _text: None, p.config.decide_s), p


def fitted(s, values: dict[Term, list[float]]) -> Fitted:
    h = Hypothesis.of(*values)
    theta = h.gather(s.sim.ctx, {t: np.array(v) for t, v in values.items()})
    return Fitted(h, theta, theta)


def reported(s: Search, f: Fitted) -> dict[str, np.ndarray]:
    """What the only effect of a fit reports, once its parameters are refined."""
    (term,) = f.hypothesis.terms
    return term.effect.report(s.sim.ctx, term.place, final_fit(s, f)[0].theta)


def exported(xml: str, parts: dict[str, tuple[str, list[float]]]) -> tuple[mujoco.MjModel, Machine]:
    """The model with effects written at their turn, and the machine on which they act: {id: (place, theta)}."""
    spec = mujoco.MjSpec.from_string(xml)
    ctx = nominal_context(compile_variable(spec))
    terms = {Term(i, find_place(ctx, REGISTRY[i], at)): np.array(theta) for i, (at, theta) in parts.items()}
    spec.compile()
    for term in Hypothesis.of(*terms).terms:
        assert term.effect.export(spec, ctx, term.place, terms[term])
    return spec.compile(), Machine.build(ctx, tuple(terms), tuple(terms.values()))


def slight(count: int, windows: int) -> np.ndarray:
    """What each of several effects takes off the squared error of every window [count, windows]: 1.05 standard errors
    on average, and no two alike. The odds of one alone are e^2.2 to 1, which is not beyond doubt, of two together
    e^4.4 to 1."""
    drawn = np.random.default_rng(0).standard_normal((windows, count + 1))
    drawn[:, 0] = 1.0
    scatter = np.linalg.qr(drawn)[0][:, 1:].T
    return 1.05 + np.sqrt(windows * (windows - 1)) * scatter
