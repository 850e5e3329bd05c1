"""Pictures of a machine by MuJoCo, made in a process of its own.

A graphics driver that is missing, hangs or crashes takes nothing with it, and `MUJOCO_GL` is set for that process
alone. What it runs is `render_process`.
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

from mpge_jax.diagnosis.report.figures import render_process
from mpge_jax.diagnosis.report.figures.render_process import MODEL, RESULT, SCENE

Array = np.ndarray
WIDTH, HEIGHT = 1100, 900
FRAME = (640, 520)
"""Width and height of one frame of a motion."""
TIME_LIMIT = 45.0
"""Seconds that one attempt may take."""
_hung: set[str | None] = set()
"""Backends that took longer once, and are not waited for again."""


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
    scene = {"points": points, "axes": axes, "bodies": np.array(bodies, int), "geoms": np.array(geoms, int)}
    found = _drawn(spec, (WIDTH, HEIGHT), {"qpos": qpos, **scene})
    return None if found is None else Picture(found["pixels"], found["points"])


def render_frames(spec: mujoco.MjSpec, frames: Array, colours: Array) -> Array | None:
    """Pictures [F, height, width, 3] of the machine in several poses at once, or None where it cannot be rendered.

    Args:
        frames: [F, K, nq]; the first pose of each is the machine as it is, the others are painted over it.
        colours: [K - 1, 4] of the others (RGBA).
    """
    found = _drawn(spec, FRAME, {"frames": frames, "colours": colours})
    return None if found is None else found["pixels"]


def _drawn(spec: mujoco.MjSpec, size: tuple[int, int], scene: dict[str, Array]) -> dict[str, Array] | None:
    """What the process gives for a scene, by the first backend that draws anything."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            mujoco.mj_saveModel(_on_white(spec, size), str(folder / MODEL), None)
        except Exception:  # whatever a description holds that cannot be shown, the diagnosis goes on
            return None
        np.savez(folder / SCENE, **scene)  # type: ignore[arg-type]
        for backend in (b for b in backends() if b not in _hung):
            found = _attempt(folder, backend)
            if found is not None:
                return found
    return None


def _attempt(folder: Path, backend: str | None) -> dict[str, Array] | None:
    environment = dict(os.environ)
    if backend is not None:
        environment["MUJOCO_GL"] = backend
    # -P: the folder of this file is no place to look for the standard library's modules
    command = [sys.executable, "-P", str(render_process.__file__), str(folder)]
    try:
        done = subprocess.run(
            command, env=environment, cwd=folder, timeout=TIME_LIMIT, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            return None
        with np.load(folder / RESULT, allow_pickle=False) as data:
            found = {key: data[key] for key in data.files}
            flat = np.ptp(found["pixels"]) == 0
    except subprocess.TimeoutExpired:
        _hung.add(backend)
        return None
    except (OSError, ValueError, KeyError):
        return None
    # some drivers report success and draw nothing
    return None if flat else found


def _on_white(spec: mujoco.MjSpec, size: tuple[int, int]) -> mujoco.MjModel:
    """The compiled model before a white sky, with a frame buffer of the size [width, height] of the picture."""
    spec = spec.copy()
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="white sky of the report", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48,
    )  # fmt: skip
    view = spec.visual.global_
    view.offwidth, view.offheight, view.fovy = *size, 30.0
    return spec.compile()
