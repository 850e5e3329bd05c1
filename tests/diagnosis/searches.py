"""Searches on small machines, and fits of given values, for several rooms' tests."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis import Config, Recording
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.recording import validate
from mpge_jax.diagnosis.selection.setup import build_search

HINGE, MOTOR = Place("joint", "hinge", 0), Place("actuator", "motor", 0)
COULOMB, STRIBECK = Term("coulomb_friction", HINGE), Term("stribeck_friction", HINGE)


DAMPING, GAIN = Term("viscous_damping", HINGE), Term("actuator_gain", MOTOR)
ARMATURE = Term("armature", HINGE)


def search_of(xml: str, recordings: list[Recording]):
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    return build_search(p, lambda _text: None, p.config.decide_s), p


def fitted(s, values: dict[Term, list[float]]) -> Fitted:
    h = Hypothesis.of(*values)
    theta = h.gather(s.sim.ctx, {t: np.array(v) for t, v in values.items()})
    return Fitted(h, theta, theta)
