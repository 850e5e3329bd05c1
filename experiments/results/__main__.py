"""`python -m experiments.results`."""

import sys

from experiments.results.page import main

if __name__ == "__main__":
    sys.exit(main())
