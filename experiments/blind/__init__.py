"""A blind benchmark of the mismatch diagnosis: draws machines with hidden physics, runs the command, marks its answers.

The physics here is written a second time and shares no code with the engine under test: the only contact is the
command `python -m experiments.diagnose` and the `diagnosis.json` that it writes.
"""
