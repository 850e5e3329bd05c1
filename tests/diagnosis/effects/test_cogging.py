"""Forces that come and go with the position: of turning motors, and of linear ones with their magnets in a row."""

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from tests.diagnosis.machines import record
from tests.diagnosis.searches import fitted, reported, search_of

STAGE = """<mujoco><option timestep="0.002"/><worldbody><body name="carriage">
<joint name="x" type="slide" axis="1 0 0" damping="4" stiffness="20"/><geom size=".05" mass="2"/></body></worldbody>
<actuator><motor name="coil" joint="x"/></actuator></mujoco>"""
WAVES = 2.0 * np.pi / 0.03
"""Magnets 30 mm apart, rad/m."""


def test_a_linear_motor_cogs_at_its_magnets():
    """Many times in a travel that is a fraction of a metre: 209 rad/m."""

    def cogs(model, data) -> None:
        data.qfrc_applied[0] += 1.5 * np.sin(WAVES * data.qpos[0] + 0.4)

    s, _ = search_of(STAGE, record(STAGE, 3.0, force=cogs, rate=250, noise=1e-5))
    term, ctx = Term("cogging_torque", Place("joint", "x", 0)), s.sim.ctx
    start = term.effect.starts(ctx, term.place)[0]
    assert start[2] == pytest.approx(WAVES, rel=0.05)
    found = reported(s, final_fit(s, fitted(s, {term: start.tolist()}))[0])
    assert found["amplitude"] == pytest.approx(1.5, rel=0.02)
    assert found["periods"] == pytest.approx(WAVES, rel=0.01)
    assert term.effect.units(ctx, term.place)["periods"] == "rad/m"
    says = term.effect.sentence(
        term.place, {"amplitude": "1.5 N", "periods": "209 rad/m", "phase": "0.4 rad"}
    )
    assert says == "A force of 1.5 N that is a sine of 209 rad/m times the position acts at the x (cogging)."


def test_what_turns_is_told_by_the_turn():
    says = REGISTRY["cogging_torque"].sentence(
        Place("joint", "hip", 0), {"amplitude": "0.1 N m", "periods": "7", "phase": "0.4 rad"}
    )
    assert says == "A torque of 0.1 N m that comes and goes 7 times a turn pulls at the hip (cogging)."


def test_what_was_not_seen_to_come_again_is_not_asked():
    """A pocket in which a joint rests, along a travel that holds no two periods of what would be like it."""

    def rests(model, data) -> None:
        q = data.qpos[0]
        data.qfrc_applied[0] -= 4.0 * np.tanh(q / 0.02) * np.exp(-((q / 0.06) ** 2))

    s, _ = search_of(STAGE, record(STAGE, 3.0, force=rests, rate=250, noise=1e-5))
    ctx, place = s.sim.ctx, Place("joint", "x", 0)
    effect, (travel,) = REGISTRY["cogging_torque"], ctx.travel
    twice = 4.0 * np.pi / travel
    assert effect.params(ctx, place)[2].low == pytest.approx(twice)
    assert all(start[2] >= twice for start in effect.starts(ctx, place))
    at_least = np.array([0.3, 0.1, 1.001 * twice])
    assert all(detour[2] > twice for detour in effect.detours(ctx, place, at_least))
    # nor where nothing tells of the angle
    blind = replace(ctx, samples=None)
    assert all(start[2] >= twice for start in effect.starts(blind, place))
