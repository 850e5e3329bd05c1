"""Ours beside peers: the arithmetic by hand, peers that are not installed, and that both fits have one objective."""

import json
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from experiments.benchmark.peers import __main__ as peers
from experiments.benchmark.peers import error_time, fit, growth, in_turn, page, rows, sac_updates
from experiments.benchmark.peers.in_turn import OURS
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.learning.sac import SACConfig
from tests.experiments.tiny import TINY

ROOT = Path(__file__).resolve().parents[3]


def test_the_page_is_that_of_the_kept_measurements():
    text = page.markdown(ROOT / "docs" / "results" / "speed")
    written = (ROOT / "docs" / "speed.md").read_text("utf-8")
    assert written == text, "python -m experiments.benchmark.peers --row writes it anew"


def test_ratios_are_of_one_round_by_hand():
    # The machine is three times as slow in the second round: ours is twice as fast in each.
    seconds = {OURS: [1.0, 3.0], "peer": [2.0, 6.0]}
    assert in_turn.ratio(seconds, {OURS: 10, "peer": 10}, "peer") == [2.0, 2.0, 2.0]
    # Of half the work in the same time.
    assert in_turn.ratio(seconds, {OURS: 10, "peer": 5}, "peer") == [4.0, 4.0, 4.0]
    assert in_turn.rates(seconds, {OURS: 10, "peer": 5}) == {OURS: 5.0, "peer": 1.25}


def test_calls_take_turns_and_warming_up_is_not_kept():
    order: list[str] = []
    # What another process measured itself is taken as it says.
    seconds = in_turn.in_turn(
        {"a": lambda: order.append("a"), "b": lambda: order.append("b") or 7.0}, 2, warm=1
    )
    assert order == ["a", "b"] * 3
    assert seconds["b"] == [7.0, 7.0] and len(seconds["a"]) == 2


def test_peers_that_are_not_installed_are_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sac_updates, "is_there", lambda _: False)
    tiny = lambda rounds: rows.sac(rounds, 1, SACConfig(hidden=(4,), batch_size=2))  # noqa: E731
    monkeypatch.setitem(peers.ROWS, "sac", tiny)
    kept, out = tmp_path / "kept", tmp_path / "speed.md"
    monkeypatch.setattr(
        "sys.argv", ["peers", "--row", "sac", "--rounds", "1", "--kept", str(kept), "--out", str(out)]
    )
    assert peers.main() == 0
    assert "SBX is not installed, so it was not run: pip install -e '.[peers]'" in capsys.readouterr().err
    assert "| SBX | not run: `pip install -e '.[peers]'` |" in out.read_text("utf-8")
    assert json.loads((kept / "sac.json").read_text())["missing"] == ["SBX", "Stable-Baselines3"]


def test_a_fit_without_its_peer_has_a_section_that_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(rows, "_has_sysid", lambda: False)
    row = rows.fits(rounds=1)
    told = {"command": "", "versions": {"machine": ""}, "load_average": [0.0, 0.0]}
    (tmp_path / "fit.json").write_text(json.dumps(row | told))
    text = page.markdown(tmp_path)
    assert f"{row['parameters']} parameters, 2 joints, {row['windows']} windows." in text
    assert "| mujoco.sysid | not run: `pip install -e '.[peers]'` |" in text
    # what was not measured is told in words too, without what only a measurement says
    assert "{" not in text


def test_a_missed_mark_is_told_with_its_number(tmp_path):
    row = {
        "seconds": {OURS: [2.0], "SBX": [2.0]},
        "amounts": {OURS: 64, "SBX": 64},
        "missing": [],
        "updates": 64,
    }
    more = {"command": "c", "versions": {"machine": "m"}, "load_average": [1.0, 2.0], "peers": {}}
    (tmp_path / "sac.json").write_text(json.dumps({**row, **more}))
    assert "| SBX | 32 | 1.00 (1.00 to 1.00) | 1.3 | **missed** |" in page.markdown(tmp_path)


def test_growth_is_the_slope_on_logarithmic_axes(tmp_path):
    row = {"growth": {"copies B": {"10": [1.0, 1.0], "1000": [100.0, 100.0]}}, "missing": [], "peers": {}}
    row["large"] = {"copies": 4096, "members": 5, "gib": 7.0, "seconds": 3.0}
    assert growth.slope(row["growth"]["copies B"]) == pytest.approx(1.0)
    assert growth.slope({"1": [3.0], "4": [6.0], "16": [12.0]}) == pytest.approx(0.5)
    text = "\n".join(growth.lines(row, "growth.png"))
    assert "| copies B | 10 | 1,000 | 1 | 100 | 1.00 |" in text
    assert "7.00 GiB at its peak (aimed at: at most 6): **missed**" in text
    assert growth.draw(row, tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


def test_a_method_that_never_gets_there_is_said_so():
    # Ours takes a fifth and a fourth of the peer's time, which at the second log does not reach 0.10 at all.
    found = {OURS: [[2.0, 0.05], [2.0, 0.09]], error_time.GAT: [[1.0, 0.06], [1.0, 0.08]]}
    found[error_time.PAPER] = [[10.0, 0.10], [8.0, 0.3]]
    by = {line.split(" | ")[0]: line for line in error_time.lines({"found": found, "preset": "quick"})}
    assert by["| mpge_jax"] == "| mpge_jax | 2 2 | 0.050 0.090 |  |  |  |"
    assert by["| GAT (inversion)"] == "| GAT (inversion) | 1 1 | 0.060 0.080 | 2 | at most 0.5 | **missed** |"
    assert by["| the paper's way (MPG-MS)"].endswith("| 10 > 8 | 0.100 0.300 | 0.23 | at most 0.5 | met |")
    found[OURS][0][1] = 0.2
    assert error_time.lines({"found": found, "preset": "quick"})[-1].endswith(
        "| 0.23 | at most 0.5 | **missed** |"
    )


@pytest.mark.slow
def test_times_to_an_error_are_measured_from_a_log(monkeypatch):
    monkeypatch.setattr(error_time, "ERROR", 100.0)
    monkeypatch.setattr(error_time, "SOURCE", "InvertedPendulum")
    monkeypatch.setattr(error_time, "TARGET", "SkewedPendulum")
    row = error_time.measure(1, TINY, every=1)
    assert set(row["found"]) == {OURS, error_time.GAT, error_time.VINE, error_time.PAPER}
    assert all(seconds > 0 and error <= 100 for ((seconds, error),) in row["found"].values())


def test_rows_without_a_measurement_are_said_to_lack(tmp_path):
    (tmp_path / "growth.json").write_text((ROOT / "docs/results/speed/growth.json").read_text("utf-8"))
    text = page.markdown(tmp_path).split("## Not measured")[1]
    assert "- Grounding: time to an error of 0.10: `--row error` measures it.\n" in text
    assert "`--row growth`" not in text


def test_what_cannot_be_measured_is_refused(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("sys.argv", ["peers", "--row", "gym", "--kept", str(tmp_path)])
    assert peers.main() == 2
    assert (
        capsys.readouterr().err
        == "peers: --row gym is not known (allowed: steps, sac, grounding, error, growth, fit)\n"
    )


def test_residuals_that_sysid_is_given_are_the_whitened_ones(tmp_path):
    given = fit.problem(tmp_path, 1, 2)
    w, sim, nothing = given.search.train, given.search.sim, Run(Hypothesis(), np.zeros(0))
    ours = given.white.excess(given.white(sim.residuals([nothing], w)[0]))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    model.opt.timestep = w.dt
    data, hook, theirs = mujoco.MjData(model), fit._whitened(given), []
    for k in range(w.count):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = w.q0[k], w.v0[k]
        state = np.zeros((w.steps, 1 + model.nq + model.nv))
        for row, command in enumerate(w.command[k, w.history :]):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            state[row] = data.time, *data.qpos, *data.qvel
        measured = SimpleNamespace(data=np.full((1, 1), float(k)))
        theirs.append((hook(None, None, measured, None, True, state)[0] ** 2).sum())
    np.testing.assert_allclose(theirs, ours / w.count, rtol=1e-6)


@pytest.mark.slow
def test_both_fits_have_one_objective(tmp_path):
    pytest.importorskip("tabulate")
    if not rows._has_sysid():
        pytest.skip("mujoco.sysid is not installed")
    given = fit.problem(tmp_path, 1, 2)
    _, theta = fit.ours(given)
    _, seen = fit.theirs(given)
    np.testing.assert_allclose(seen[-1][1], theta, rtol=0.05)
    assert given.loss(seen[-1][1]) == pytest.approx(given.loss(theta), rel=0.02)
