"""Capsule inertia of MuJoCo before 2.1.2, with which the paper's experiments ran.

Those engines took a capsule's mass and inertia from a cylinder of the same radius, half a radius longer at each end.
"""

import mujoco


def use_legacy_inertia(spec: mujoco.MjSpec) -> None:
    """Gives every capsule of `spec` the mass and inertia of its longer cylinder; contacts are unchanged.

    Each capsule becomes massless, and a cylinder that touches nothing is added to its body to carry the mass.
    """
    # A geom's id is set by compiling, and a capsule's size and place (`fromto`) are known only then.
    measured = spec.copy()
    model = measured.compile()
    for geom, index in [(geom, known.id) for geom, known in zip(spec.geoms, measured.geoms, strict=True)]:
        if geom.type != mujoco.mjtGeom.mjGEOM_CAPSULE:
            continue
        radius, half_length = model.geom_size[index][:2]
        twin = geom.parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, half_length + radius / 2, 0.0],
            pos=model.geom_pos[index],
            quat=model.geom_quat[index],
            contype=0,
            conaffinity=0,
            group=geom.group,
            # Fully transparent: neither drawn nor met by rays.
            material="",
            rgba=[0.0, 0.0, 0.0, 0.0],
        )
        twin.density, twin.mass, twin.typeinertia = geom.density, geom.mass, geom.typeinertia
        geom.mass = 0.0
