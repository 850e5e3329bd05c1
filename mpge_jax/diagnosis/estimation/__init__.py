"""Parameters of a hypothesis from windows: whitening, screening, fits, intervals and what a fit misses."""
