"""The shifts of HalfCheetah and Hopper in ODRL, under its names: `halfcheetah-friction-0.5`, `hopper-morph-foot-easy`.

ODRL is the benchmark for off-dynamics reinforcement learning of Lyu et al. (NeurIPS 2024 Datasets and Benchmarks,
arXiv:2410.20750; MIT, github.com/OffDynamicsRL/off-dynamics-rl). Its kinds, parts and levels are kept; its model
files of these two robots were not at hand. The factors are those of its humanoid files (`humanoid_gravity_*.xml`,
`humanoid_kinematic_hipjnt_*.xml`, `humanoid_morph_leg_*.xml`). That they hold for HalfCheetah and Hopper is an
assumption, above all for `morph`, where its humanoid's torso has other factors than its leg. So returns here are not to
be set beside ODRL's tables; nor are its source tasks (Gym's, in MuJoCo 2.1) quite this project's.

- friction: every coefficient of every geom times 0.1, 0.5, 2 or 5.
- gravity: times 0.1, 0.5, 2 or 5.
- kinematic: the ranges of some joints times 0.8 (easy), 0.5 (medium) or 0.2 (hard).
- morph: the radii of some links times 1.25 (easy), 0.75 (medium) or 1.5 (hard). HalfCheetah keeps its total mass.

A range that ends at 0 where the robot stands (Hopper's) keeps that end.
"""

from collections.abc import Iterable
from functools import partial

import mujoco
import numpy as np

from envs.types import Variant

SCALES = (0.1, 0.5, 2.0, 5.0)
RANGES = {"easy": 0.8, "medium": 0.5, "hard": 0.2}
RADII = {"easy": 1.25, "medium": 0.75, "hard": 1.5}

_JOINTS: dict[str, dict[str, tuple[str, ...]]] = {
    "HalfCheetah": {"thighjnt": ("bthigh", "fthigh"), "footjnt": ("bfoot", "ffoot")},
    "Hopper": {"legjnt": ("leg_joint",), "footjnt": ("foot_joint",)},
}
_GEOMS: dict[str, dict[str, tuple[str, ...]]] = {
    "HalfCheetah": {"torso": ("torso", "head"), "thigh": ("bthigh", "fthigh")},
    "Hopper": {"torso": ("torso_geom",), "foot": ("foot_geom",)},
}


def _friction(scale: float, spec: mujoco.MjSpec) -> None:
    for geom in spec.geoms:
        geom.friction = scale * np.array(geom.friction)


def _gravity(scale: float, spec: mujoco.MjSpec) -> None:
    spec.option.gravity = scale * np.array(spec.option.gravity)


def _kinematic(joints: tuple[str, ...], factor: float, spec: mujoco.MjSpec) -> None:
    for name in joints:
        joint = spec.joint(name)
        joint.range = factor * np.array(joint.range)


def _morph(geoms: tuple[str, ...], factor: float, spec: mujoco.MjSpec) -> None:
    for name in geoms:
        geom = spec.geom(name)
        geom.size = [factor * geom.size[0], *geom.size[1:]]


def _of(task: str) -> list[Variant]:
    name = task.lower()
    found = []
    for scale in SCALES:
        for kind, change in (("friction", _friction), ("gravity", _gravity)):
            about = f"ODRL: {kind} times {scale:g}"
            found.append(Variant(f"{name}-{kind}-{scale}", task, about, spec=partial(change, scale)))
    for part, joints in _JOINTS[task].items():
        for level, factor in RANGES.items():
            about = f"ODRL: range of {' and '.join(joints)} times {factor:g}"
            shift = partial(_kinematic, joints, factor)
            found.append(Variant(f"{name}-kinematic-{part}-{level}", task, about, spec=shift))
    for part, geoms in _GEOMS[task].items():
        for level, factor in RADII.items():
            about = f"ODRL: radius of {' and '.join(geoms)} times {factor:g}"
            shift = partial(_morph, geoms, factor)
            found.append(Variant(f"{name}-morph-{part}-{level}", task, about, spec=shift))
    return found


ODRL = (*_of("HalfCheetah"), *_of("Hopper"))


def folded(names: Iterable[str]) -> str:
    """Names in a message, where those of ODRL are one pattern for each robot."""
    ours = {variant.name for variant in ODRL}
    return ", ".join(dict.fromkeys(f"{n.partition('-')[0]}-... (ODRL)" if n in ours else n for n in names))
