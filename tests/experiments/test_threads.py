"""Commands leave small matrices to one thread, unless told otherwise."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(("told", "threads"), [(None, "1"), ("3", "3")])
def test_matrices_have_one_thread_unless_told_otherwise(told, threads):
    env = {k: x for k, x in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    if told is not None:
        env["OPENBLAS_NUM_THREADS"] = told
    code = "import experiments, sys, os; assert 'numpy' not in sys.modules; print(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == threads
