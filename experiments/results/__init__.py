"""The page of results: what sweeps and benchmarks left, as tables and pictures."""
