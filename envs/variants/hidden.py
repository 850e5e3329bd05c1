"""Targets with physics that the paper's have not: what a simulator lacks and no log shows by itself.

All run on every backend. The diagnosis has a name for what is hidden in the first six (docs/vocabulary.md), and none
for the last: a spring between two joints.
"""

import mujoco

from envs.types import Variant


def _sticky(spec: mujoco.MjSpec) -> None:
    spec.joint("fthigh").frictionloss = 60.0


def _sticky_cart(spec: mujoco.MjSpec) -> None:
    spec.joint("slider").frictionloss = 150.0


def _loaded(spec: mujoco.MjSpec) -> None:
    spec.body("torso").add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.02, 0.0, 0.0],
        pos=[-0.06, 0.0, 0.1],
        mass=1.5,
        contype=0,
        conaffinity=0,
    )


def _slippery(spec: mujoco.MjSpec) -> None:
    for geom in spec.geoms:
        geom.friction[0] = 0.05


def _strapped(spec: mujoco.MjSpec) -> None:
    strap = spec.add_tendon(name="strap", stiffness=90.0, damping=3.0, springlength=[0.0, 0.0])
    strap.wrap_joint("bthigh", 1.0)
    strap.wrap_joint("fthigh", 1.0)


HIDDEN = (
    Variant("LatePendulum", "InvertedPendulum", "the cart's command comes 20 ms late", delay=1),
    Variant("LateCheetah", "HalfCheetah", "all commands come 20 ms late", delay=2),
    Variant(
        "StickyPendulum", "InvertedPendulum", "150 N of dry friction on the cart's rail", spec=_sticky_cart
    ),
    Variant("StickyCheetah", "HalfCheetah", "60 N m of dry friction in the front hip", spec=_sticky),
    Variant("LoadedHopper", "Hopper", "1.5 kg at the back of the torso", spec=_loaded),
    Variant("SlipperyCheetah", "HalfCheetah", "a sliding friction of 0.05 in place of 0.4", spec=_slippery),
    Variant(
        "StrappedCheetah",
        "HalfCheetah",
        "an elastic strap pulls both hips to opposite angles",
        spec=_strapped,
    ),
)
