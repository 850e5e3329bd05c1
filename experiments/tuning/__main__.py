"""Grounds in the tuning tasks with every candidate, and writes docs/tuning.md.

python -m experiments.tuning --out results/tuning
"""

import sys

from experiments.tuning.search import main

if __name__ == "__main__":
    sys.exit(main())
