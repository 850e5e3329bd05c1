"""Pictures of a machine by MuJoCo, made in a process of its own.

A graphics driver that is missing, hangs or crashes takes nothing with it, and `MUJOCO_GL` is set for that process
alone. This file is both sides: the process runs it as a script, which therefore imports nothing of this project.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

Array = np.ndarray
WIDTH, HEIGHT = 1100, 900
TIME_LIMIT = 45.0
"""Seconds that one attempt may take."""
RED, FLOOR = (0.84, 0.15, 0.09, 1.0), (0.93, 0.94, 0.95, 1.0)
_MODEL, _SCENE, _RESULT = "model.mjb", "scene.npz", "picture.npz"


@dataclass(frozen=True)
class Picture:
    """pixels: [HEIGHT, WIDTH, 3] bytes. points: [M, 2] where the points lie in it, from the top left."""

    pixels: Array
    points: Array


def backends() -> tuple[str | None, ...]:
    """Values of `MUJOCO_GL` to try: the user's choice, else those that need no display (None: the platform's)."""
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    if chosen:
        return () if chosen in ("off", "disable", "disabled", "false", "0") else (chosen,)
    return ("egl", "osmesa") if sys.platform.startswith("linux") else (None,)


def render(
    spec: mujoco.MjSpec, qpos: Array, points: Array, axes: Array, bodies: list[int], geoms: list[int]
) -> Picture | None:
    """The machine at `qpos` [nq] on white, or None where it cannot be rendered.

    Args:
        points: [M, 3] points whose pixels are wanted. axes: [M, 3] unit vector of a red axis through each point
            (zero: none). bodies, geoms: indices of what is painted red.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            mujoco.mj_saveModel(_on_white(spec), str(folder / _MODEL), None)
        except Exception:  # whatever a description holds that cannot be shown, the diagnosis goes on
            return None
        painted = {"bodies": np.array(bodies, int), "geoms": np.array(geoms, int)}
        np.savez(folder / _SCENE, qpos=qpos, points=points, axes=axes, **painted)  # type: ignore[arg-type]
        for backend in backends():
            picture = _attempt(folder, backend)
            if picture is not None:
                return picture
    return None


def _attempt(folder: Path, backend: str | None) -> Picture | None:
    environment = dict(os.environ)
    if backend is not None:
        environment["MUJOCO_GL"] = backend
    # -P: the folder of this file is no place to look for the standard library's modules
    command = [sys.executable, "-P", __file__, str(folder)]
    try:
        done = subprocess.run(
            command, env=environment, cwd=folder, timeout=TIME_LIMIT, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            return None
        with np.load(folder / _RESULT, allow_pickle=False) as data:
            picture = Picture(data["pixels"], data["points"])
    except (OSError, subprocess.TimeoutExpired, ValueError, KeyError):
        return None
    # some drivers report success and draw nothing
    return picture if np.ptp(picture.pixels) > 0 else None


def _on_white(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled model before a white sky, with a frame buffer that is large enough."""
    spec = spec.copy()
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="white sky of the report", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48,
    )  # fmt: skip
    view = spec.visual.global_
    view.offwidth, view.offheight, view.fovy = WIDTH, HEIGHT, 30.0
    return spec.compile()


# The process that draws.


def _main(folder: Path) -> None:
    model = mujoco.MjModel.from_binary_path(str(folder / _MODEL))
    with np.load(folder / _SCENE, allow_pickle=False) as file:
        scene = {key: file[key] for key in file.files}
    data = mujoco.MjData(model)
    data.qpos[:] = scene["qpos"]
    mujoco.mj_forward(model, data)
    red = np.isin(model.geom_bodyid, scene["bodies"]) | np.isin(np.arange(model.ngeom), scene["geoms"])
    model.geom_rgba[red], model.geom_matid[red] = RED, -1
    # a patterned floor draws the eye away from the machine
    floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_rgba[:, 3] > 0) & ~red
    model.geom_rgba[floor], model.geom_matid[floor] = FLOOR, -1
    shown = _shown(model)
    box = _corners(model, data, shown)
    size = float(np.ptp(box, axis=0).max())
    model.stat.extent, model.stat.center = size, box.mean(0)
    model.vis.map.znear, model.vis.map.zfar = 0.02, 40.0
    model.vis.headlight.ambient = np.maximum(model.vis.headlight.ambient, 0.4)
    option = mujoco.MjvOption()
    option.geomgroup[:] = [g in set(model.geom_group[shown]) for g in range(len(option.geomgroup))]
    camera = _camera(model, data, box)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera, option)
        for point, along in zip(scene["points"], scene["axes"], strict=True):
            if np.any(along):
                _axis(renderer.scene, point, 0.16 * size * along, 0.012 * size)
        pixels = renderer.render()
        points = _project(renderer.scene, scene["points"])
    np.savez(folder / _RESULT, pixels=pixels, points=points)


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
    reach = [np.abs(local @ right) / (half * WIDTH / HEIGHT), np.abs(local @ np.cross(right, forward)) / half]
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


def _project(scene: mujoco.MjvScene, points: Array) -> Array:
    """Pixels [M, 2] of points [M, 3], by the mean of the two eyes."""
    left, right_eye = scene.camera
    position = 0.5 * (np.array(left.pos) + np.array(right_eye.pos))
    forward, up = np.array(left.forward, float), np.array(left.up, float)
    local = points.reshape(-1, 3) - position
    depth = local @ forward
    scale = 0.5 * HEIGHT * left.frustum_near / (0.5 * (left.frustum_top - left.frustum_bottom)) / depth
    return np.stack(
        [0.5 * WIDTH + scale * (local @ np.cross(forward, up)), 0.5 * HEIGHT - scale * (local @ up)], 1
    )


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
