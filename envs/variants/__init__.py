"""The targets that come with the project, as data."""

from envs.variants.hidden import HIDDEN
from envs.variants.odrl import ODRL, folded
from envs.variants.paper import PAPER

VARIANTS = (*PAPER, *HIDDEN, *ODRL)

__all__ = ["HIDDEN", "ODRL", "PAPER", "VARIANTS", "folded"]
