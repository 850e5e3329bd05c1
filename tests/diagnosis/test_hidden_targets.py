"""What the diagnosis names in 500 steps of the targets with hidden physics; docs/targets.md has it in a column."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.diagnosis.test_paper_targets import diagnosed, rollout_log

PAGE = Path(__file__).parents[2] / "docs" / "targets.md"
DRIVES = ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")
# Verdict, effect, places, a parameter and its true value.
# The strap has no name: a function of both hips' angles stands for it at either of them.
FOUND = {
    "LatePendulum": ("effects", "actuator_delay", ("slide",), "delay", 0.02),
    "LateCheetah": ("effects", "actuator_delay", DRIVES, "delay", 0.02),
    "StickyPendulum": ("effects", "coulomb_friction", ("slider",), "torque", 150.0),
    "StickyCheetah": ("effects", "coulomb_friction", ("fthigh",), "torque", 60.0),
    "LoadedHopper": ("effects", "payload_mass", ("torso",), "mass", 1.5),
    "SlipperyCheetah": ("effects", "contact_friction", ("world",), "mu", 0.05),
    "StrappedCheetah": ("unexplained", "residual", ("fthigh", "bthigh"), None, None),
}


@pytest.mark.slow
@pytest.mark.parametrize("target", FOUND)
def test_what_is_hidden_is_named_or_said_to_be_unexplained(target):
    verdict, effect, places, name, value = FOUND[target]
    d = diagnosed(target, rollout_log(target))
    named = d.effects()["effects"]
    assert d.verdict == verdict
    assert [(e["id"], e["at"]) for e in named] == [(effect, place) for place in places]
    for e in named:
        if name is None:
            assert e["form"].count("q[") == e["form"].count("q@") == 1
        else:
            assert e["parameters"][name] == pytest.approx(value, rel=0.01)


def test_the_page_says_what_is_found():
    text = PAGE.read_text("utf-8")
    for target, (verdict, effect, *_) in FOUND.items():
        (line,) = [x for x in text.splitlines() if x.startswith(f"| `{target}` ")]
        assert line.endswith(f"| `{verdict}`: `{effect}` |"), f"{target}: {line}"
