"""Real machines: recordings of test benches, never trained on their held-out files. Each writes its page."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.parameters import candidates_of
from mpge_jax.diagnosis.summary import markdown, window_errors

ROOT = Path(__file__).parents[2]
RECORDINGS = Path(os.environ.get("MPGE_RECORDINGS", ROOT.parent / "shared" / "data" / "recordings"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of real machines are not here"),
]


def _diagnose(folder: Path, title: str, page: str):
    d = diagnose(folder / "model.xml", folder, Config(jobs=os.cpu_count() or 1))
    path = ROOT / "docs" / "machines" / page
    path.parent.mkdir(parents=True, exist_ok=True)
    command = (
        f"python -m experiments.diagnose --model {folder.name}/model.xml --recordings {folder.name} --out out"
    )
    path.write_text(markdown(d, title, command), encoding="utf-8")
    assert all(s.recording.name.startswith("heldout_") for s in d.prepared.held_sources)
    assert not any(s.recording.name.startswith("heldout_") for s in d.prepared.train_sources)
    return d


@pytest.mark.parametrize("design", ["A0", "C0", "C1"])
def test_double_pendulum(design):
    folder = RECORDINGS / "dfki_double_pendulum" / "standard" / design
    d = _diagnose(folder, f"Double pendulum {design}", f"double_pendulum_{design}.md")
    ratio = window_errors(d.held, False) / window_errors(d.held, True)
    # what the recordings cannot tell apart is named as the candidates of `ambiguous`
    named = set(d.terms).union(*(f.hypothesis.terms for fits in candidates_of(d).values() for f in fits))
    assert {t.place.name for t in named} >= {"shoulder", "elbow"}
    assert (ratio > 5).all()


def test_servo_pendulum_has_more_than_coulomb_and_viscous_friction():
    folder = RECORDINGS / "bam_xl330_pendulum" / "standard"
    d = _diagnose(folder, "XL330 servo lifting a pendulum", "servo_pendulum.md")
    plain = diagnose(
        folder / "model.xml",
        folder,
        Config(jobs=os.cpu_count() or 1, effects=("coulomb_friction", "viscous_damping")),
    )
    assert np.median(d.held.after.window) < 0.5 * np.median(plain.held.after.window)
