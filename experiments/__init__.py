"""Commands: `sweep`, `diagnose`, `pretrain`, `benchmark`. The library never imports from here."""

import os

# Before numpy: the diagnosis solves many small systems, and threads of BLAS that wait for one another make them slower
# the more cores there are and the busier these are. JAX and MuJoCo have threads of their own.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
