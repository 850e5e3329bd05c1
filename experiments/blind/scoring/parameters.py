"""Comparing a reported parameter with the truth: 10 % of the value, and whether the interval contains it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

TOLERANCE = 0.10
#: Scales where "10 %" of the value would mean nothing: angles in radians, and a reference that may be near zero.
LEAST_SCALE = {"phase": 1.0, "reference": 0.5}
GRAVITY = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Compared:
    """`error` is relative (inf when the parameter was not reported); `contained` has one entry per component."""

    effect: str
    name: str
    error: float
    contained: tuple[bool, ...]  # empty: no interval was given

    @property
    def within(self) -> bool:
        """Whether the value is within 10 % of the truth."""
        return self.error <= TOLERANCE


def compare(effect: str, truth: dict, reported: dict, plane: list[int]) -> list[Compared]:
    """All parameters of one effect. `plane`: the components of vectors that the machine's motion can show."""
    if effect == "gravity_tilt" and truth:
        truth, reported = _canonical_tilt(truth), _canonical_tilt_report(reported)
    if effect == "cogging_torque":
        reported = _canonical_cogging(reported)
    return [_one(effect, name, value, reported.get(name), plane) for name, value in truth.items()]


def _one(effect: str, name: str, truth, entry, plane: list[int]) -> Compared:
    if not isinstance(entry, dict) or "value" not in entry:
        return Compared(effect, name, np.inf, ())
    try:
        t = np.atleast_1d(np.asarray(truth, float))
        v = np.atleast_1d(np.asarray(entry["value"], float))
        low, high = _array(entry.get("low")), _array(entry.get("high"))
        if name == "axis":
            angle = float(np.arccos(np.clip(t @ v / np.linalg.norm(v), -1, 1)))
            return Compared(effect, name, angle, ())
        if len(t) == 3:
            t, v, low, high = t[plane], v[plane], _at(low, plane), _at(high, plane)
        delta = v - t
        if name == "phase":
            delta = (delta + np.pi) % (2 * np.pi) - np.pi
            if low is not None and high is not None:
                low, high = t + delta - (v - low), t + delta + (high - v)
        scale = max(float(np.linalg.norm(t)), LEAST_SCALE.get(name, 1e-12))
        error = float(np.linalg.norm(delta)) / scale
        if low is None or high is None:
            return Compared(effect, name, error, ())
        slack = 1e-9 * scale
        inside = (low - slack <= t) & (t <= high + slack)
        return Compared(effect, name, error, tuple(bool(x) for x in inside))
    except (TypeError, ValueError, IndexError):
        return Compared(effect, name, np.inf, ())


def _array(x) -> np.ndarray | None:
    return None if x is None else np.atleast_1d(np.asarray(x, float))


def _at(x: np.ndarray | None, plane: list[int]) -> np.ndarray | None:
    return None if x is None else x[plane]


def _canonical_tilt(p: dict) -> dict:
    """The same turned gravity by the shortest rotation: angle >= 0, axis horizontal."""
    axis = np.asarray(p["axis"], float)
    turned = Rotation.from_rotvec(p["angle"] * axis / np.linalg.norm(axis)).apply(GRAVITY)
    cross = np.cross(GRAVITY, turned)
    angle = float(np.arctan2(np.linalg.norm(cross), GRAVITY @ turned))
    return {"angle": angle, "axis": cross / max(float(np.linalg.norm(cross)), 1e-12)}


def _canonical_tilt_report(reported: dict) -> dict:
    """The reported rotation in the same form; its interval moves with the angle's sign and value."""
    try:
        angle, axis = reported["angle"], reported["axis"]
        new = _canonical_tilt({"angle": float(angle["value"]), "axis": axis["value"]})
        out = {"angle": {"value": new["angle"]}, "axis": {"value": new["axis"]}}
        if angle.get("low") is not None and angle.get("high") is not None:
            below, above = angle["value"] - angle["low"], angle["high"] - angle["value"]
            if angle["value"] < 0:
                below, above = above, below
            out["angle"] |= {"low": new["angle"] - below, "high": new["angle"] + above}
        return out
    except (KeyError, TypeError, ValueError, AttributeError):
        return {}


def _canonical_cogging(reported: dict) -> dict:
    """-A sin(x + phi) is A sin(x + phi + pi), and A sin(-n q + phi) is A sin(n q - phi + pi)."""
    out = {name: dict(entry) for name, entry in reported.items() if isinstance(entry, dict)}
    try:
        if out["periods"]["value"] < 0:
            _negate(out["periods"])
            _negate(out["phase"])
            _shift(out["phase"])
        if out["amplitude"]["value"] < 0:
            _negate(out["amplitude"])
            _shift(out["phase"])
    except (KeyError, TypeError):
        pass
    return out


def _negate(entry: dict) -> None:
    entry["value"] = -entry["value"]
    if entry.get("low") is not None and entry.get("high") is not None:
        entry["low"], entry["high"] = -entry["high"], -entry["low"]


def _shift(entry: dict) -> None:
    for key in ("value", "low", "high"):
        if entry.get(key) is not None:
            entry[key] = entry[key] + np.pi
