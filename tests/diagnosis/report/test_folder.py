"""A diagnosis stands when all of its files do: whoever finds `diagnosis.json` finds the others."""

import errno
import json

import mujoco
import pytest

from mpge_jax import files
from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.report.figures import drawing
from tests.diagnosis.machines import PENDULUM, record

LAST = "diagnosis.json"


@pytest.fixture(scope="module")
def diagnosed():
    def more_damping(model):
        model.dof_damping[0] += 0.05

    recordings = record(PENDULUM, 1.0, change=more_damping, count=2, seconds=1.5)
    spec = mujoco.MjSpec.from_string(PENDULUM)
    return diagnose(spec, recordings, Config(jobs=1, effects=("viscous_damping",), quiet=True))


def test_a_disk_that_is_full_at_any_file_leaves_no_finished_diagnosis(diagnosed, tmp_path, monkeypatch):
    """Every file in turn is the one for which there is no room."""
    monkeypatch.setenv("MUJOCO_GL", "off")
    write = files.write_text
    room, written = [0], []

    def taken(path):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        room[0] -= 1
        written.append(path.name)

    monkeypatch.setattr(files, "write_text", lambda path, text: (taken(path), write(path, text)))
    # files that are there or not, whatever they show
    monkeypatch.setattr(drawing, "save", lambda figure, path: (taken(path), path.write_bytes(b""), path)[2])
    for count in range(30):
        room[0], out = count, tmp_path / str(count)
        written.clear()
        try:
            diagnosed.write(out)
        except OSError as error:
            assert error.errno == errno.ENOSPC and not (out / LAST).exists() and len(written) == count
        else:
            break
    assert written[-1] == LAST and len(written) > 8
    assert json.loads((out / LAST).read_text())["verdict"] == "effects"
    # what was half there is written again
    room[0] = 30
    diagnosed.write(tmp_path / "3")
    names = [sorted(p.name for p in folder.rglob("*")) for folder in (tmp_path / "3", out)]
    assert names[0] == names[1]
