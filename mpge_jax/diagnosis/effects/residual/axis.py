"""What such a force may depend on, with the range in which that was seen."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Place, joint_unit
from mpge_jax.diagnosis.effects.step import Array

WITHIN_TURN, ANGLE, SPEED, DRIVE, LOAD, TURNED = "a", "q", "v", "f", "l", "z"
PART = "a part of a turn"
INPUTS = {
    WITHIN_TURN: f"angle of the joint within {PART}",
    ANGLE: "position of the joint",
    SPEED: "speed of the joint",
    DRIVE: "force of the joint's drives",
    LOAD: "force of gravity and of the other links on the joint",
    TURNED: "travel of the joint since it turned",
}
"""A function of the angle within a turn, or within one of equal parts of it (of teeth, notches or poles), is the same
after each. The travel since a joint turned back lies between minus and plus a farthest one: it begins at one end and
stays at the other."""
OF_OTHERS = (ANGLE, SPEED, DRIVE)
"""Inputs that may be another joint's: a coupling of joints, or of their drives."""
NAMED = r"[^\[\],@]+"
"""Names of other joints that an identifier can hold."""
AXIS = rf"([qvf]@{NAMED}|[aqvflz])\[([^\[\],]+),([^\[\],]+)(?:,(\d+))?\]"
"""An axis in an identifier: its input, the ends of its range, and `Axis.knots` where these are not the usual."""
KNOTS = {1: 9, 2: 6}
"""Values by which a function is told along each input, of one and of two inputs, where nothing says that it needs
more."""
LEAST = 4
"""Values that a cubic spline has at least."""


def part_of_turn(parts: int) -> float:
    """One of so many equal parts of a turn (rad), as identifiers have it."""
    return float(f"{2.0 * np.pi / parts:.6g}")


def key_of(which: str, joint: str = "") -> str:
    """An input: 'q' of the joint on which a function acts, 'q@elbow' of another one."""
    return f"{which}@{joint}" if joint else which


@dataclass(frozen=True)
class Axis:
    """One input with the range in which it was seen; beyond, the function stays as at the end of it.

    Attributes:
        joint: whose it is, where that is not the joint on which the function acts. knots: values by which the function
            is told along it; 0: as many as usual (`KNOTS`).
    """

    input: str
    low: float
    high: float
    joint: str = ""
    knots: int = 0

    def __post_init__(self) -> None:
        if (
            self.input not in INPUTS
            or (self.joint and not (self.input in OF_OTHERS and re.fullmatch(NAMED, self.joint)))
            or not np.isfinite([self.low, self.high]).all()
            or not self.low < self.high
            or (self.input == TURNED and self.low != -self.high)
            or (self.around and (self.low, self.high) != (0.0, part_of_turn(self.parts)))
            or 0 != self.knots < LEAST
        ):
            raise ValueError(
                f"an input of a residual is one of {', '.join(INPUTS)} with a range and {LEAST} values or more, not "
                f"{self}."
            )

    @staticmethod
    def of_key(key: str, low: float, high: float, knots: int = 0) -> Axis:
        which, _, joint = key.partition("@")
        return Axis(which, low, high, joint, knots)

    @staticmethod
    def since_turn(most: float) -> Axis:
        """Of the travel since the joint turned, up to `most` (rad or m) from either end."""
        most = float(f"{most:.6g}")
        return Axis(TURNED, -most, most)

    @staticmethod
    def within_turn(parts: int = 1) -> Axis:
        """Of the angle within one of so many equal parts of a turn."""
        return Axis(WITHIN_TURN, 0.0, part_of_turn(parts))

    @property
    def around(self) -> bool:
        """Whether the end of the range is its beginning."""
        return self.input == WITHIN_TURN

    @property
    def parts(self) -> int:
        """Ranges in a turn, where their ends are their beginnings; else 1."""
        return max(round(2.0 * np.pi / self.high), 1) if self.around and self.high > 0.0 else 1

    @property
    def part(self) -> str:
        """'a turn' or '1/6 of a turn'."""
        return "a turn" if self.parts == 1 else f"1/{self.parts} of a turn"

    @property
    def key(self) -> str:
        """What its values are: see `key_of`; 'z0.05' of the travel since the joint turned, which goes as far as the
        range does; the position of the joint, of the angle within a turn."""
        if self.around:
            return ANGLE
        return f"{TURNED}{self.high:.6g}" if self.input == TURNED else key_of(self.input, self.joint)

    @property
    def letter(self) -> str:
        """As formulas have it: 'q', or 'q(elbow)' of another joint."""
        return f"{self.input}({self.joint})" if self.joint else self.key[0]

    @property
    def says(self) -> str:
        """'position of the joint' on which the function acts, 'position of the elbow' of another one."""
        said = INPUTS[self.input]
        if self.around:
            return said.replace(PART, self.part)
        return said.replace("the joint", f"the {self.joint}") if self.joint else said

    def place(self, ctx: Context, acts: Place) -> Place:
        """The joint whose input it is; where the function acts: `acts`."""
        if not self.joint:
            return acts
        if self.joint not in ctx.names.joints:
            raise ValueError(f"the model has no joint '{self.joint}', on which a residual depends.")
        return Place("joint", self.joint, ctx.names.joints.index(self.joint))

    def within(self, x: np.ndarray) -> np.ndarray:
        """Values [...] as they lie in the range: at the end of it beyond, or in the same place of another turn."""
        return np.mod(x, 2.0 * np.pi / self.parts) if self.around else np.clip(x, self.low, self.high)

    def share(self, x: Array) -> Array:
        """Which part [...] of the range, or of how many ranges one after the other, lies before values [...]."""
        return x * (self.parts / (2.0 * np.pi)) if self.around else (x - self.low) / (self.high - self.low)

    def unit(self, ctx: Context, acts: Place) -> str:
        place = self.place(ctx, acts)
        angle, force = joint_unit(ctx, place, "rad", "m"), joint_unit(ctx, place, "N m", "N")
        return {WITHIN_TURN: angle, ANGLE: angle, TURNED: angle, SPEED: f"{angle}/s"}.get(self.input, force)

    def __str__(self) -> str:
        many = f",{self.knots}" if self.knots else ""
        return f"{key_of(self.input, self.joint)}[{self.low:.6g},{self.high:.6g}{many}]"
