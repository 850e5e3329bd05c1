"""Of hundreds of functions those are fitted that look like what short pieces lack, couplings of joints among them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.evidence.folds import FOLDS
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.residual.hints import HINTS, hinted
from mpge_jax.diagnosis.residual.inputs import REPEATS, functions, places_of, seen
from mpge_jax.diagnosis.residual.points import Pieces
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import HINGE, prepared_of

TURNS = ("z0.2", "z0.8")
KEYS = ("q", "v", "l", "f", "q@elbow", "v@elbow", "f@elbow", "q@wrist", "v@wrist")
RNG = np.random.default_rng(0)
VALUES = {key: RNG.uniform(-1.0, 1.0, 300) for key in KEYS}
VALUES |= {key: float(key[1:]) * RNG.uniform(-1.0, 1.0, 300) for key in TURNS}
# of a slide nothing repeats within a turn
HINGED = False
STRETCHES = np.arange(300) * FOLDS // 300


def pieces(force: np.ndarray, noise: float = 0.02) -> Pieces:
    unsure = np.full(force.size, noise)
    seen = force + noise * np.random.default_rng(1).standard_normal(force.size)
    return Pieces(seen, unsure, VALUES, STRETCHES)


def inputs(effect: Residual) -> str:
    return ("dry " if effect.dry else "") + " ".join(a.key for a in effect.axes)


def test_functions_are_of_the_joint_of_another_one_or_of_both():
    said = [inputs(e) for e in functions(VALUES, HINGED)]
    assert said[: len(KEYS)] == ["q", "v", "l", "f", *KEYS[4:]] and len(set(said)) == len(said)
    assert {"q v", "v q@elbow", "q@elbow v@elbow", "l v@wrist"} < set(said)
    assert not any("elbow" in x and "wrist" in x for x in said)
    # dry friction depends on its own joint alone
    own = {x for x in said if not ("elbow" in x or "wrist" in x or "dry" in x or "z" in x)}
    assert {x for x in said if "dry" in x} == {f"dry {x}" for x in own}
    # what depends on the travel since a turn, on nothing else
    assert [x for x in said if "z" in x] == list(TURNS)


@pytest.mark.parametrize(
    ("force", "want"),
    [
        (0.6 * VALUES["q@elbow"] * VALUES["v@elbow"], "q@elbow v@elbow"),
        (0.3 * VALUES["v"] * VALUES["q"] ** 2, "q v"),
        (0.1 * VALUES["f@elbow"], "f@elbow"),
        (-0.5 * VALUES["z0.2"], "z0.2"),
        (-0.2 * np.sign(VALUES["v"]) * np.exp(-((VALUES["q"] / 0.3) ** 2)), "dry q"),
    ],
)
def test_what_explains_most_is_hinted_at(force, want):
    every = functions(VALUES, HINGED)
    found = [inputs(e) for e in hinted(every, HINGE, [pieces(force)])]
    own, others, alone = found[:4], found[4 : 4 + HINTS], found[4 + HINTS :]
    assert want in others and own == ["q", "v", "l", "f"]
    # beyond these only what one of two inputs explains alone
    assert all(any(set(x.split()) < set(two.split()) for two in others) for x in alone)


def test_what_one_of_two_inputs_explains_alone_is_asked_too():
    """Half of a drive's force acts here, and with each of four inputs a little more or less of it does."""
    share = 0.5 + 0.05 * sum(VALUES[key] for key in ("q", "v", "l", "f"))
    found = [
        inputs(e) for e in hinted(functions(VALUES, HINGED), HINGE, [pieces(share * VALUES["f@elbow"], 0.01)])
    ]
    assert set(found[4 : 4 + HINTS]) == {f"{key} f@elbow" for key in ("q", "v", "l", "f")}
    assert found[4 + HINTS :] == ["f@elbow"]


@pytest.mark.parametrize("place", [-0.6, 0.1])
def test_what_is_narrow_is_told_by_more_values(place):
    """A magnet's pull within a twentieth of the range, and a wave that goes once through it."""
    away = (VALUES["q"] - place) / 0.08
    magnet, wave = -0.5 * away / (1.0 + away**2) ** 2.5, 0.2 * np.sin(3.0 * VALUES["q"])
    usual, fine = (hinted(functions(VALUES, HINGED), HINGE, [pieces(x, 0.01)])[0] for x in (wave, magnet))
    assert (inputs(usual), usual.counts) == ("q", (9,))
    assert inputs(fine) == "q" and fine.counts[0] > 9


def test_a_narrow_rough_spot_is_hinted_at():
    force = -0.5 * np.sign(VALUES["v"]) * np.exp(-(((VALUES["q"] - 0.3) / 0.06) ** 2))
    (found,) = [e for e in hinted(functions(VALUES, HINGED), HINGE, [pieces(force)]) if inputs(e) == "dry q"]
    assert found.counts[0] > 9


@pytest.mark.parametrize("waves", [11.0, 16.0])
def test_damping_that_comes_and_goes_with_the_angle_is_told_by_more_values_along_it(waves):
    """The finer the waves, the less of them do few values show: then another function explains as much by chance."""
    force = -0.3 * VALUES["v"] * (0.1 + np.sin(waves * VALUES["q"]))
    first = hinted(functions(VALUES, HINGED), HINGE, [pieces(force)])[4]
    assert inputs(first) == "q v" and first.counts == (18, 6)


def test_travels_since_a_turn_leave_room_for_others():
    """Four of them that are the same, and a coupling that explains a little less."""
    travel = 0.2 * RNG.uniform(-1.0, 1.0, 300)
    same = {f"z{most}": travel for most in (0.2, 0.201, 0.202, 0.203)}
    values = {key: x for key, x in VALUES.items() if key not in TURNS} | same
    force = travel + 0.3 * VALUES["q@elbow"] * VALUES["v@elbow"]
    these = Pieces(force, np.full(300, 0.02), values, STRETCHES)
    found = [inputs(e) for e in hinted(functions(values, HINGED), HINGE, [these])][4:]
    assert "q@elbow v@elbow" in found and len([x for x in found if x.startswith("z")]) == HINTS // 2


def test_what_repeats_within_a_turn_is_told_by_that_part_of_it():
    """Six notches in a turn, each of 4 degrees; a bent shaft that touches once in a turn."""
    values = {key: x for key, x in VALUES.items() if "@" not in key} | {"q": RNG.uniform(-9.0, 11.0, 300)}

    def best(force: np.ndarray) -> Residual:
        seen = force + 0.02 * np.random.default_rng(1).standard_normal(300)
        every = functions(values, True)
        first = hinted(every, HINGE, [Pieces(seen, np.full(300, 0.02), values, STRETCHES)])
        return next(e for e in first if e.axes[0].around and len(e.axes) == 1 and e.axes[0].parts == repeats)

    repeats = 6
    beside = (values["q"] - 0.2 + np.pi / 6) % (np.pi / 3) - np.pi / 6
    (notch,) = best(-10.0 * beside * np.exp(-0.5 * (beside / 0.07) ** 2)).axes
    assert notch.knots == 18 and notch.says == "angle of the joint within 1/6 of a turn"
    repeats = 1
    (bent,) = best(0.5 * np.exp(2.0 * np.cos(values["q"]) - 2.0)).axes
    assert bent.knots == 0 and bent.says == "angle of the joint within a turn" and bent.key == "q"

    turned = [a for e in functions(values, True) for a in e.axes if a.around]
    assert {a.parts for a in turned} == set(REPEATS)
    assert not any(a.around for e in functions(values, False) for a in e.axes)
    # over 2 rad, a third of a turn is not seen twice, and a tenth is
    short = functions(VALUES, True)
    assert {a.parts for e in short for a in e.axes if a.around} == {n for n in REPEATS if n > 6}


def test_the_length_of_the_pieces_is_the_one_that_shows_most():
    force = 0.6 * VALUES["q@elbow"] * VALUES["v@elbow"]
    blurred, clear = pieces(0.05 * force, 0.3), pieces(force)
    for tried in ([blurred, clear], [clear, blurred]):
        assert inputs(hinted(functions(VALUES, HINGED), HINGE, tried)[4]) == "q@elbow v@elbow"


def test_where_nothing_is_missing_or_known_only_the_joints_own_inputs_are_tried():
    every = functions(VALUES, HINGED)
    few = Pieces(np.ones(5), np.ones(5), {key: x[:5] for key, x in VALUES.items()}, np.arange(5))
    for tried in ([], [few], [pieces(np.zeros(300), 0.0)]):
        assert [inputs(e) for e in hinted(every, HINGE, tried)] == ["q", "v", "l", "f"]


def test_inputs_of_other_joints_are_what_these_do():
    p = prepared_of(ARM, record(ARM, [4.0, 0.8], count=3, seconds=1.0))
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(ARM)))
    shoulder, elbow = (places_of(p, [name])[0] for name in ctx.names.joints)
    here, there = seen(p, shoulder), seen(p, elbow)
    turns = {key for key in here if key.startswith("z")}
    assert set(here) - turns == {"q", "v", "l", "f", "q@elbow", "v@elbow", "f@elbow"} and len(turns) == 6
    assert all(np.abs(here[key]).max() <= float(key[1:]) for key in turns)
    for key in "qv":
        np.testing.assert_array_equal(here[f"{key}@elbow"], there[key])
        np.testing.assert_array_equal(there[f"{key}@shoulder"], here[key])
    np.testing.assert_array_equal(there["f@shoulder"], here["f"])
