"""The process in which MuJoCo draws a machine: a script for `robot_render` to run, which imports nothing of ours."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

Array = np.ndarray
MODEL, SCENE, RESULT = "model.mjb", "scene.npz", "picture.npz"
"""Files of the folder that it is given, and of what it leaves there."""
RED, FLOOR = (0.84, 0.15, 0.09, 1.0), (0.93, 0.94, 0.95, 1.0)
GREY = 0.62
"""Brightness of a machine beside which it is painted again."""
TRAVELS = 2.5
"""Times its own size from which on the camera goes along with a machine."""


def main(folder: Path) -> None:
    """Draws what lies in a folder: the model, and a scene of one pose with marks or of several frames."""
    model = mujoco.MjModel.from_binary_path(str(folder / MODEL))
    with np.load(folder / SCENE, allow_pickle=False) as file:
        scene = {key: file[key] for key in file.files}
    model.vis.map.znear, model.vis.map.zfar = 0.02, 40.0
    model.vis.headlight.ambient = np.maximum(model.vis.headlight.ambient, 0.4)
    drawn = _frames(model, **scene) if "frames" in scene else _marked(model, scene)
    np.savez(folder / RESULT, **drawn)  # type: ignore[arg-type]


def _marked(model: mujoco.MjModel, scene: dict[str, Array]) -> dict[str, Array]:
    """One pose with what is named painted red, and where points lie in the picture."""
    data = _posed(model, scene["qpos"])
    red = np.isin(model.geom_bodyid, scene["bodies"]) | np.isin(np.arange(model.ngeom), scene["geoms"])
    model.geom_rgba[red], model.geom_matid[red] = RED, -1
    _plain_floor(model, ~red)
    shown = _shown(model)
    box = _corners(model, data, shown)
    size = _measured(model, box)
    with _renderer(model) as renderer:
        renderer.update_scene(data, _camera(model, data, box), _option(model, shown))
        for point, along in zip(scene["points"], scene["axes"], strict=True):
            if np.any(along):
                _axis(renderer.scene, point, 0.16 * size * along, 0.012 * size)
        pixels = renderer.render()
        return {"pixels": pixels, "points": _project(model, renderer.scene, scene["points"])}


def _frames(model: mujoco.MjModel, frames: Array, colours: Array) -> dict[str, Array]:
    """[F] pictures of poses [F, K, nq] from one place, or beside a machine that travels."""
    _plain_floor(model, np.ones(model.ngeom, bool))
    moving = model.body_weldid[model.geom_bodyid] != 0
    model.geom_rgba[moving, :3], model.geom_matid[moving] = GREY, -1
    shown, first = _shown(model), _posed(model, frames[0, 0])
    boxes = [_corners(model, _posed(model, poses[0]), shown) for poses in frames]
    whole = np.concatenate(boxes)
    travels = np.ptp(whole, axis=0).max() > TRAVELS * max(np.ptp(box, axis=0).max() for box in boxes)
    _measured(model, boxes[0] if travels else whole)
    camera, option = _camera(model, first, boxes[0] if travels else whole), _option(model, shown)
    out = []
    with _renderer(model) as renderer:
        for poses, box in zip(frames, boxes, strict=True):
            if travels:
                camera.lookat[:] = 0.5 * (box.max(0) + box.min(0))
            renderer.update_scene(_posed(model, poses[0]), camera, option)
            for pose, colour in zip(poses[1:], colours, strict=True):
                _ghost(model, renderer.scene, pose, colour, option)
            out.append(renderer.render().copy())
    return {"pixels": np.array(out)}


def _ghost(
    model: mujoco.MjModel, scene: mujoco.MjvScene, pose: Array, colour: Array, option: mujoco.MjvOption
) -> None:
    """Adds what moves of the machine in another pose, in one colour."""
    if not np.isfinite(pose).all():
        return
    before = scene.ngeom
    moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(model, _posed(model, pose), option, mujoco.MjvPerturb(), moving, scene)
    for k in range(before, scene.ngeom):
        scene.geoms[k].rgba[:], scene.geoms[k].matid = colour, -1


def _posed(model: mujoco.MjModel, qpos: Array) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def _plain_floor(model: mujoco.MjModel, where: Array) -> None:
    """A patterned floor draws the eye away from the machine."""
    floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_rgba[:, 3] > 0) & where
    model.geom_rgba[floor], model.geom_matid[floor] = FLOOR, -1


def _measured(model: mujoco.MjModel, box: Array) -> float:
    """Size (m) of what is shown, which the model is told too."""
    size = float(np.ptp(box, axis=0).max())
    model.stat.extent, model.stat.center = size, box.mean(0)
    return size


def _option(model: mujoco.MjModel, shown: Array) -> mujoco.MjvOption:
    option = mujoco.MjvOption()
    option.geomgroup[:] = [g in set(model.geom_group[shown]) for g in range(len(option.geomgroup))]
    return option


def _renderer(model: mujoco.MjModel) -> mujoco.Renderer:
    return mujoco.Renderer(model, model.vis.global_.offheight, model.vis.global_.offwidth)


def _shown(model: mujoco.MjModel) -> Array:
    """[ngeom] geoms that are drawn: the usual groups, or all of them where the machine is in none of those."""
    moving = model.body_weldid[model.geom_bodyid] != 0
    visible = model.geom_rgba[:, 3] > 0
    usual = visible & (model.geom_group <= 2)
    shown = usual if (usual & moving).any() else visible
    if not (shown & moving).any():
        raise SystemExit("the machine has no shape to show")
    return shown


def _corners(model: mujoco.MjModel, data: mujoco.MjData, shown: Array) -> Array:
    """Corners [n, 3] of the boxes around the machine's geoms, and around fixed ones that are no larger than it."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T

    def corners(g: int) -> Array:
        local = model.geom_aabb[g, :3] + signs * model.geom_aabb[g, 3:]
        return data.geom_xpos[g] + local @ data.geom_xmat[g].reshape(3, 3).T

    moving = shown & (model.body_weldid[model.geom_bodyid] != 0)
    machine = np.concatenate([corners(int(g)) for g in np.flatnonzero(moving)])
    size = np.linalg.norm(np.ptp(machine, axis=0))
    parts = [machine]
    for g in map(int, np.flatnonzero(shown & ~moving)):
        near = np.linalg.norm(data.geom_xpos[g] - machine.mean(0)) < size
        if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE and model.geom_rbound[g] < 0.6 * size and near:
            parts.append(corners(g))
    return np.concatenate(parts)


def _camera(model: mujoco.MjModel, data: mujoco.MjData, box: Array) -> mujoco.MjvCamera:
    """Look nearly along the axis about which most joints turn, from as near as shows the whole box."""
    spread = np.zeros((3, 3))
    for j in range(model.njnt):
        outer = np.outer(data.xaxis[j], data.xaxis[j])
        kind = model.jnt_type[j]
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            spread += outer
        elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
            spread += 0.5 * (np.eye(3) - outer)
    values, vectors = np.linalg.eigh(spread)
    along = vectors[:, -1]
    azimuth, elevation = 130.0, -20.0
    if values[-1] > 0.6 * max(np.trace(spread), 1e-9):
        if abs(along[2]) > 0.7:
            azimuth, elevation = 110.0, -50.0
        else:
            along = along * (1.0 if along[1] - along[0] > 0 else -1.0)
            azimuth, elevation = float(np.rad2deg(np.arctan2(along[1], along[0]))) + 18.0, -14.0
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.5 * (box.max(0) + box.min(0))
    camera.azimuth, camera.elevation = azimuth, elevation
    a, e = np.deg2rad([azimuth, elevation])
    forward = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    local = box - camera.lookat
    half = np.tan(np.deg2rad(0.5 * float(model.vis.global_.fovy))) / 1.3
    aspect = model.vis.global_.offwidth / model.vis.global_.offheight
    reach = [np.abs(local @ right) / (half * aspect), np.abs(local @ np.cross(right, forward)) / half]
    camera.distance = float(np.max(np.maximum(*reach) - local @ forward))
    return camera


def _axis(scene: mujoco.MjvScene, point: Array, along: Array, width: float) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(RED, np.float32))
    mujoco.mjv_connector(geom, kind, width, point - along, point + along)
    scene.ngeom += 1


def _project(model: mujoco.MjModel, scene: mujoco.MjvScene, points: Array) -> Array:
    """Pixels [M, 2] of points [M, 3], by the mean of the two eyes."""
    left, right_eye = scene.camera
    position = 0.5 * (np.array(left.pos) + np.array(right_eye.pos))
    forward, up = np.array(left.forward, float), np.array(left.up, float)
    local = points.reshape(-1, 3) - position
    depth = local @ forward
    width, height = model.vis.global_.offwidth, model.vis.global_.offheight
    scale = 0.5 * height * left.frustum_near / (0.5 * (left.frustum_top - left.frustum_bottom)) / depth
    return np.stack(
        [0.5 * width + scale * (local @ np.cross(forward, up)), 0.5 * height - scale * (local @ up)], 1
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
