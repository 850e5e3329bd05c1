"""Recordings of motion and force without commands: what the motion needs against what was measured."""
