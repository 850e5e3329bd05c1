"""All machines by name.

Every machine says where each effect may be drawn. Places where an effect is identical in principle to another one
at the same place (a payload on a cart and its rotor inertia, say) are left out, or listed in `equivalence.py`.
"""

from experiments.blind.robots.arms import ARMS
from experiments.blind.robots.movers import MOVERS
from experiments.blind.robots.papers import PAPERS
from experiments.blind.robots.robot import Robot

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (*ARMS, *MOVERS, *PAPERS)}
