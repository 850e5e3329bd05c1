"""Machines that hardly moved: every effect has somewhere to start from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import Samples
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import prepared_of


@pytest.fixture(scope="module")
def ctx():
    return prepared_of(PENDULUM, record(PENDULUM, 0.8, count=2)).ctx


@pytest.mark.parametrize("span", [0.0, 1e-6, 0.03])
def test_every_effect_starts_somewhere(ctx, span):
    rng = np.random.default_rng(0)
    q = np.full((200, 1), 0.2) + span * np.sin(np.linspace(0, 6, 200))[:, None]
    samples = Samples(q, np.gradient(q, 0.01, axis=0), rng.standard_normal(q.shape), np.ones(q.shape))
    small = replace(ctx, samples=samples, travel=np.full(1, max(span, 1e-4)))
    for effect in REGISTRY.values():
        for place in effect.places(small):
            starts = np.asarray(effect.starts(small, place))
            assert starts.ndim == 2 and len(starts) and np.isfinite(starts).all(), effect.id
