"""Real machines: recordings of test benches, never trained on their held-out files. Each writes its page."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.build_search import build_search
from mpge_jax.diagnosis.fit import fit
from mpge_jax.diagnosis.fitted import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis
from mpge_jax.diagnosis.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.parameters import candidates_of
from mpge_jax.diagnosis.prepare import prepare
from mpge_jax.diagnosis.reader import load_recordings
from mpge_jax.diagnosis.summary import markdown, window_errors
from mpge_jax.diagnosis.verdict import errors

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
    data = folder.relative_to(RECORDINGS)
    command = f"python -m experiments.diagnose --model {data}/model.xml --recordings {data} --out out"
    path.write_text(markdown(d, title, command), encoding="utf-8")
    assert all(s.recording.name.startswith("heldout_") for s in d.prepared.held_sources)
    assert not any(s.recording.name.startswith("heldout_") for s in d.prepared.train_sources)
    return d


OWN_ZERO = "the encoders of C0's held-out session had other zeros, see the test below"


@pytest.mark.parametrize(
    "design", ["A0", pytest.param("C0", marks=pytest.mark.xfail(strict=True, reason=OWN_ZERO)), "C1"]
)
def test_double_pendulum(design):
    folder = RECORDINGS / "dfki_double_pendulum" / "standard" / design
    d = _diagnose(folder, f"Double pendulum {design}", f"double_pendulum_{design}.md")
    ratio = window_errors(d.held, False) / window_errors(d.held, True)
    # what the recordings cannot tell apart is named as the candidates of `ambiguous`
    named = set(d.terms).union(*(f.hypothesis.terms for fits in candidates_of(d).values() for f in fits))
    assert {t.place.name for t in named} >= {"shoulder", "elbow"}
    assert (ratio > 5).all()


def test_the_encoders_of_the_held_out_session_of_c0_had_other_zeros():
    """No fit to the training files can know it: there the same two offsets vanish."""
    folder = RECORDINGS / "dfki_double_pendulum" / "standard" / "C0"
    spec = load_spec(folder / "model.xml")
    plain = compile_variable(spec)
    names = names_of(plain)
    p = prepare(spec, load_recordings([folder], plain, names, None), Config(jobs=os.cpu_count() or 1))
    s = build_search(p, lambda _text: None, p.config.decide_s)
    wanted = ("armature", "coulomb_friction", "encoder_offset")
    terms = [t for t in s.terms if t.id in wanted]
    windows = p.windows(True, p.config.report_s, 60, seed=1)
    ratio, offsets = {}, {}
    for name, fitted_to in (("training", s.train), ("held-out", s.held)):
        parts = {t: np.asarray(t.effect.starts(p.ctx, t.place))[0] for t in terms}
        hypothesis = Hypothesis.of(*terms)
        start = hypothesis.gather(p.ctx, parts)
        found, white = Fitted(hypothesis, start, start), s.whiten_one(NOTHING, fitted_to)
        for _ in range(3):
            found = fit(p.sim, [found], fitted_to, white)[0]
            white = s.whiten_one(found, fitted_to)
        values = hypothesis.split(p.ctx, found.theta)
        offsets[name] = np.array([values[t][0] for t in terms if t.id == "encoder_offset"])
        before, after = errors(p.sim, NOTHING, windows), errors(p.sim, found, windows)
        medians = [np.median(np.sqrt(np.nanmean(e.curves**2, axis=1)), axis=0) for e in (before, after)]
        ratio[name] = medians[0] / medians[1]
    assert (np.abs(offsets["training"]) < 0.01).all()
    assert (np.abs(offsets["held-out"]) > 0.03).all()
    assert (ratio["training"] < 5).all() and (ratio["held-out"] > 1.5 * ratio["training"]).all()


def test_servo_pendulum_has_more_than_coulomb_and_viscous_friction():
    folder = RECORDINGS / "bam_xl330_pendulum" / "standard"
    d = _diagnose(folder, "XL330 servo lifting a pendulum", "servo_pendulum.md")
    plain = diagnose(
        folder / "model.xml",
        folder,
        Config(jobs=os.cpu_count() or 1, effects=("coulomb_friction", "viscous_damping")),
    )
    assert np.median(d.held.after.window) < 0.5 * np.median(plain.held.after.window)
