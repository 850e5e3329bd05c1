"""Commands on a clock of their own: what their delays have in common is the clock's, as far as it is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.measurement.commands_clock import common_delay, with_later_commands
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.selection.procedure import Decision
from mpge_jax.diagnosis.selection.setup import build_search
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import fitted, prepared_of

SHOULDER, ELBOW = (
    Term("actuator_delay", Place("actuator", name, i))
    for i, name in enumerate(("shoulder_motor", "elbow_servo"))
)


def prepared(*within: float):
    """An arm's recordings with commands whose clocks are known to within so many s."""
    logs = record(ARM, [1.0, 1.0], count=len(within))
    return prepared_of(ARM, [replace(r, clock_within=x) for r, x in zip(logs, within, strict=True)])


@pytest.mark.parametrize(
    ("within", "delays", "common"),
    [
        ((0.005, 0.005), (0.002, 0.032), 0.002),
        ((0.005, 0.005), (0.008, 0.032), 0.005),
        ((0.005, 0.004), (0.008, 0.032), 0.004),
        # one of them obeys at once, so the delay is the other's
        ((0.005, 0.005), (None, 0.032), 0.0),
        # one log tells that the commands are late indeed
        ((0.005, 0.0), (0.002, 0.032), 0.0),
    ],
)
def test_what_all_delays_have_in_common_is_taken_off_as_far_as_the_clock_is_unknown(within, delays, common):
    p = prepared(*within)
    s = build_search(p, lambda _text: None, p.config.decide_s)
    f = fitted(s, {t: [x] for t, x in zip((SHOULDER, ELBOW), delays, strict=True) if x is not None})
    assert common_delay(p, f) == common
    again = MeasurementModel.without_physics(p, {}).with_moved_clock(Decision(f, {}, None, None, None))
    assert (again is not None) == bool(common) == any("it was taken off" in w for w in p.warnings)
    if again is not None:
        np.testing.assert_array_equal(again.read().train[0].late, [common, common])


def test_later_commands_act_later_but_for_those_whose_force_was_measured():
    p = replace(prepared(0.005, 0.005), measured=np.array([True, False]))
    moved = with_later_commands(with_later_commands(p, 0.004), 0.003).train[0]
    edges = np.arange(0.1, 0.4, 0.001)
    was = p.train[0].mean_command(edges)
    np.testing.assert_allclose(moved.mean_command(edges)[:, 0], was[:, 0], atol=1e-12)
    np.testing.assert_allclose(moved.mean_command(edges)[7:, 1], was[:-7, 1], atol=1e-9)
    assert np.ptp(was[:, 1]) > 0.1
