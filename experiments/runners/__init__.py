"""Where jobs run: in this process, in several, on a Ray cluster, or under Slurm.

A job is a function of a frozen description; it writes a folder of its own, its result last, and is skipped where that
stands. So a run that was cut short goes on with the same command, on whichever runner.
"""

from experiments.runners.dispatch import check, run
from experiments.runners.job import Cost, Ended, Job, Refused
from experiments.runners.options import Options

__all__ = ["Cost", "Ended", "Job", "Options", "Refused", "check", "run"]
