"""The public machines: where their recordings lie, what their makers know of them, and what a plain fit reached."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

NEAR = 1.1
"""Times an expert's error that is taken for as good."""


@dataclass(frozen=True)
class Reference:
    """Errors of held-out recordings by those of an expert's plain fit.

    Attributes:
      of: "force": rms error over rms of the measured force, by actuator; "each": median of the windows' rms errors, by
        joint, or of a free body's position and rotation; "median": the same over all joints together.
      errors: in the order of the model. What the fit reached, of forces; of a motion (rad or m) no more is known than
        the fit's error and a tenth.
    """

    of: Literal["force", "each", "median"]
    errors: tuple[float, ...]

    @property
    def enough(self) -> tuple[float, ...]:
        """Errors that are as good: those of the fit and a tenth."""
        return tuple(NEAR * x for x in self.errors) if self.of == "force" else self.errors


@dataclass(frozen=True)
class Machine:
    """One machine.

    Attributes:
      key: names its page in docs/machines and its file in docs/results/atlas.
      title: as on the page.
      folder: below the folder of recordings; holds `model.xml` and the recordings. The first part of it has the README.
      known: what its makers say of its physics.
      reference: None where nobody's plain fit is at hand.
    """

    key: str
    title: str
    folder: str
    known: str
    reference: Reference | None = None


_DFKI = "dfki_double_pendulum/standard/"
_SIMPLE = "torque_limited_simple_pendulum/standard/"
_DRIVES = "6:1 drives with rotors of 6.1e-5 kg m^2; no friction given"
_SIMPLE_KNOWN = "viscous friction 0.1 to 0.35 N m s/rad, dry friction 1.3 N m, backlash of 0.15 deg"

MACHINES = {
    machine.key: machine
    for machine in (
        Machine(
            "multiarm_pendulum",
            "Free pendulum on a cart that stands",
            "multiarm_pendulum/standard",
            "one viscous damping coefficient",
            Reference("median", (0.0014,)),
        ),
        Machine(
            "brfd",
            "Friction damper with backlash",
            "brfd/standard",
            "dry friction with hysteresis, and backlash",
            Reference("force", (0.35,)),
        ),
        Machine(
            "ur10_bag",
            "UR10 on an exciting trajectory",
            "ur10_bag/standard",
            "friction in every joint: a sigmoid of the speed, viscous and constant terms",
            Reference("force", (0.15, 0.05, 0.06, 0.08, 0.12, 0.26)),
        ),
        Machine(
            "panda_bag",
            "Franka Panda on an exciting trajectory",
            "panda_bag/standard",
            "friction in every joint: a sigmoid of the speed, 0.3 to 1.28 N m peak to peak",
            Reference("force", (0.40, 0.02, 0.03, 0.01, 0.19, 0.08, 0.21)),
        ),
        Machine(
            "simple_pendulum_swing_up",
            "Simple pendulum, swing-ups by torque",
            f"{_SIMPLE}swing_up",
            _SIMPLE_KNOWN,
            Reference("median", (0.019,)),
        ),
        Machine(
            "simple_pendulum_other_weight",
            "Simple pendulum with another weight",
            f"{_SIMPLE}other_weight",
            f"another weight than the model's; {_SIMPLE_KNOWN}",
            Reference("median", (0.026,)),
        ),
        Machine(
            "simple_pendulum_tracking",
            "Simple pendulum that tracks a path",
            f"{_SIMPLE}tracking",
            _SIMPLE_KNOWN,
        ),
        Machine(
            "simple_pendulum_uncut",
            "Simple pendulum, whole recordings",
            f"{_SIMPLE}uncut",
            f"{_SIMPLE_KNOWN}; nothing on what happens after the first swing-up",
        ),
        Machine("double_pendulum_A0", "Double pendulum A0", f"{_DFKI}A0", _DRIVES),
        Machine("double_pendulum_C0", "Double pendulum C0", f"{_DFKI}C0", _DRIVES),
        Machine("double_pendulum_C1", "Double pendulum C1", f"{_DFKI}C1", _DRIVES),
        Machine(
            "servo_pendulum",
            "XL330 servo lifting a pendulum",
            "bam_xl330_pendulum/standard",
            "friction that grows with the load, and Stribeck's, are their subject",
            Reference("median", (0.031,)),
        ),
        Machine(
            "kinova_gen3",
            "Kinova Gen3",
            "kinova_gen3/standard",
            "terms on offer: friction, rotor inertia, stiffness, offset; no values",
            Reference("force", (0.16, 0.15, 0.08, 0.29, 0.14, 0.17, 0.25)),
        ),
        Machine(
            "cube_toss",
            "Cube thrown onto a board",
            "cube_toss/standard",
            "friction coefficient 0.18 (the model has 1.0), restitution 0.125; the ground 1 mm higher than it is",
            Reference("each", (0.021, 0.17)),
        ),
        Machine(
            "go2_legs",
            "Unitree Go2, legs in the air",
            "go2_legs/standard",
            "they fit rotor inertia, viscous and dry friction, an offset of each encoder, one delay; no values",
            Reference("median", (0.011,)),
        ),
    )
}


def check_known(keys: Iterable[str]) -> None:
    """Raises ValueError, one sentence, for a machine that is not in the list."""
    for key in keys:
        if key not in MACHINES:
            raise ValueError(f"--machine {key} is not known (allowed: {', '.join(MACHINES)})")
