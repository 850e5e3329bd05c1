"""Fleets end in the same bytes wherever their robots are diagnosed; of Ray's with a node killed: tests/.../runners."""

import json
import sys

import pytest

from experiments.fleet import __main__ as command
from tests.experiments.fleet.small_fleet import COEFFICIENTS, make, results_of


@pytest.fixture(scope="module", autouse=True)
def without_pictures():
    """Pictures of machines take longer than all else here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUJOCO_GL", "off")
        yield


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Options of a fleet, and what one process makes of it."""
    folder = tmp_path_factory.mktemp("fleet")
    options = make(folder)
    return options, run(options, folder / "alone")


def run(options, out, *more):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["fleet", *options, "--out", str(out), *more])
        assert command.main() == 0
    return results_of(out)


def test_several_processes_leave_the_bytes_of_one(fleet, tmp_path):
    options, alone = fleet
    assert {f"robots/{name}/diagnosis.json" for name in COEFFICIENTS} | {"fleet.json", "fleet.html"} <= set(
        alone
    )
    odd = json.loads(alone["fleet.json"])["robots"]
    found = {n: odd[n]["effects"][0]["parameters"]["coefficient"]["value"] for n in COEFFICIENTS}
    assert found == pytest.approx(COEFFICIENTS, rel=0.05)
    assert run(options, tmp_path / "two", "--workers", "2") == alone


@pytest.mark.slow
def test_submitit_leaves_them_too(fleet, tmp_path):
    pytest.importorskip("submitit", reason="submitit is not installed: pip install -e '.[slurm]'")
    options, alone = fleet
    assert run(options, tmp_path / "queued", "--runner", "slurm", "--executor", "local") == alone
