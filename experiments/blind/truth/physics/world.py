"""Effects of masses, gravity, wind and contacts."""

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import Stages
from experiments.blind.vocabulary import Effect


def payload_mass(effect: Effect, stages: Stages[Plant]) -> None:
    """A point mass in the body's frame: a massive child body welded to it."""

    def edit(spec: mujoco.MjSpec) -> None:
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        point = spec.body(effect.at).add_body(name=f"payload of {effect.at}", pos=effect.vector("position"))
        point.explicitinertial = True
        point.mass, point.ipos, point.inertia = effect.number("mass"), [0, 0, 0], [1e-9] * 3

    stages.spec.append(edit)


def mass_scale(effect: Effect, stages: Stages[Plant]) -> None:
    """Every mass and inertia times one factor; rotor inertias stay."""
    factor = effect.number("factor")

    def tune(plant: Plant) -> None:
        plant.model.body_mass *= factor
        plant.model.body_inertia *= factor
        plant.refresh()

    stages.model.append(tune)


def com_offset(effect: Effect, stages: Stages[Plant]) -> None:
    """The centre of mass moved in the body's frame, the inertia about it unchanged."""

    def edit(spec: mujoco.MjSpec) -> None:
        nominal = spec.compile()
        b = nominal.body(effect.at)
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        body = spec.body(effect.at)
        body.explicitinertial = True
        body.mass, body.inertia, body.iquat = float(b.mass[0]), b.inertia, b.iquat
        body.ipos = b.ipos + effect.vector("offset")

    stages.spec.append(edit)


def gravity_tilt(effect: Effect, stages: Stages[Plant]) -> None:
    """The rotation (angle, axis) that turns the nominal gravity vector into the true one."""
    axis = np.array(effect.vector("axis"))
    rotation = Rotation.from_rotvec(effect.number("angle") * axis / np.linalg.norm(axis))

    def tune(plant: Plant) -> None:
        plant.model.opt.gravity[:] = rotation.apply(plant.model.opt.gravity)

    stages.model.append(tune)


def external_force(effect: Effect, stages: Stages[Plant]) -> None:
    """A constant force in the world's frame at the body's centre of mass."""
    force = np.array(effect.vector("force"))
    stages.joint.append(lambda plant, extra: plant.push(effect.at, force, extra))


def contact_friction(effect: Effect, stages: Stages[Plant]) -> None:
    """Sliding friction of every contact (`world`), or of every contact of one geom."""
    mu = effect.number("mu")

    def tune(plant: Plant) -> None:
        if effect.at == "world":
            plant.model.geom_friction[:, 0] = mu
        else:
            g = plant.model.geom(effect.at).id
            plant.model.geom_friction[g, 0] = mu
            plant.model.geom_priority[g] = (
                plant.model.geom_priority.max() + 1
            )  # a pair takes the larger mu otherwise

    stages.model.append(tune)


def contact_stiffness(effect: Effect, stages: Stages[Plant]) -> None:
    """Another time constant of every contact's spring-damper."""
    time_constant = effect.number("time_constant")

    def tune(plant: Plant) -> None:
        plant.model.geom_solref[:, 0] = time_constant

    stages.model.append(tune)
