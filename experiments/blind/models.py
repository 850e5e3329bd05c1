"""All machines by name.

Every machine says where each effect may be drawn. Places where an effect is identical in principle to another one
at the same place (a payload on a cart and its rotor inertia, say) are left out, or listed in `equivalence.py`.
"""

from experiments.blind.arms import ARMS
from experiments.blind.movers import MOVERS
from experiments.blind.papers import PAPERS
from experiments.blind.robot import Robot

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (*ARMS, *MOVERS, *PAPERS)}
