"""Jobs under Slurm: the batch scripts that are submitted, and jobs run by submitit itself or by a stand-in of Slurm."""

import os
from pathlib import Path

import pytest

from experiments import runners
from experiments.runners import Options
from tests.experiments.runners.jobs import results_of, sums

pytest.importorskip("submitit", reason="submitit is not installed: pip install -e '.[slurm]'")

from experiments.runners import slurm

# Keeps the script, and runs its array as Slurm would, one task after the other.
SBATCH = """#!/bin/sh
cp "$1" "$FAKE/script.sh"
echo "Submitted batch job 12"
[ -e "$FAKE/run" ] || exit 0
last=$(sed -n 's/^#SBATCH --array=0-\\([0-9]*\\).*/\\1/p' "$1")
export SLURM_ARRAY_JOB_ID=12 SLURM_JOB_NUM_NODES=1 SLURM_NTASKS=1 SLURM_JOB_NODELIST=here
export SLURM_PROCID=0 SLURM_LOCALID=0 SLURM_NODEID=0
(for n in $(seq 0 "$last"); do
    SLURM_JOB_ID=$((12 + n)) SLURM_ARRAY_TASK_ID=$n sh "$FAKE/script.sh"
done) >/dev/null 2>&1 &
"""
SRUN = '#!/bin/sh\nshift 5\nexec "$@"\n'
SACCT = "#!/bin/sh\necho 'JobID|State|NodeList'\n"


@pytest.fixture
def stand_in(monkeypatch, tmp_path):
    """The folder of a Slurm that keeps the last script; with a file `run` in it, it also runs it."""
    folder = tmp_path / "fake"
    folder.mkdir()
    for name, text in (("sbatch", SBATCH), ("srun", SRUN), ("sacct", SACCT)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("FAKE", str(folder))
    monkeypatch.setenv("PATH", str(folder), prepend=os.pathsep)
    return folder


def test_the_script_asks_for_what_a_job_may_use(stand_in, tmp_path):
    options = Options(
        runner="slurm",
        cpus=4,
        gpus=1,
        memory_gb=6.0,
        hours=1.5,
        sbatch=("partition=long", "account=robots"),
    )
    slurm.executor_of(options, tmp_path / "logs").map_array(slurm.Resumable(), sums(tmp_path, 3))
    script = (stand_in / "script.sh").read_text()
    asked = {line.removeprefix("#SBATCH --") for line in script.splitlines() if line.startswith("#SBATCH")}
    assert {
        "cpus-per-task=4",
        "gpus-per-node=1",
        "mem=6GB",
        "time=90",
        "partition=long",
        "account=robots",
        "job-name=mpge",
        # Nobody but Slurm's own limits decides how many run at once; a warning comes 90 s before the end.
        "array=0-2%3",
        "signal=USR2@90",
    } <= asked
    command = [line for line in script.splitlines() if line.startswith("srun")]
    assert len(command) == 1 and f"submitit.core._submit {tmp_path / 'logs'}" in command[0]


def test_a_machine_without_slurm_is_told_so(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="--runner slurm needs a machine that submits to Slurm"):
        list(runners.run(sums(tmp_path, 1), Options(runner="slurm"), tmp_path / "logs"))


def ended_and_results(folder: Path, options: Options) -> tuple[dict[str, str], dict[str, bytes]]:
    folder.mkdir()
    jobs = sums(folder, 3, job_1={"how": "raises"})
    return {e.name: e.reason for e in runners.run(jobs, options, folder / "logs")}, results_of(folder)


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["local", "slurm"])
def test_jobs_end_as_on_this_machine(stand_in, tmp_path, executor):
    (stand_in / "run").touch()
    alone = ended_and_results(tmp_path / "alone", Options())
    assert alone[0] == {"job_0": "", "job_1": "FloatingPointError: it diverged", "job_2": ""}
    assert ended_and_results(tmp_path / executor, Options(runner="slurm", executor=executor)) == alone
