"""What each method of the comparison does, for all seeds of a cell at once."""

from experiments.methods.cell import Cell, LogFiles, Method, Outcome
from experiments.methods.grounded import grounding_config
from experiments.methods.registry import METHODS, from_logs, known_samples
from experiments.methods.run import run

__all__ = [
    "METHODS",
    "Cell",
    "LogFiles",
    "Method",
    "Outcome",
    "from_logs",
    "grounding_config",
    "known_samples",
    "run",
]
