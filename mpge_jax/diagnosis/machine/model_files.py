"""Which files a model description may read, and the meshes of URDF files that lie in a ROS package.

Descriptions (`<include>`, models inside models) stay in the model's folder. Meshes and images are mere data and may
also lie beside that folder (`../meshes`) or anywhere in the ROS package that holds it (the nearest folder above with
a `package.xml`), as long as their ending says what they are.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from xml.parsers import expat

import mujoco

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model_sizes import check_sizes

DATA = (".stl", ".obj", ".msh", ".png", ".ktx", ".hdr", ".skn")
"""Endings of data that may lie outside of the model's folder."""
COLLADA = ".dae"
"""Common for what is only seen; MuJoCo cannot read it."""
_DESCRIPTIONS = ("include", "model", "attach")
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_LEVELS = 4
"""How far above the model a `package.xml` is looked for."""


def check(path: Path) -> None:
    """Refuse what lies outside of the folders above.

    Raises:
        InputError: a file is missing or malformed, or refers to what it may not.
    """
    root, home = path.parent, package_of(path)
    references: list[tuple[Path, str, str, str]] = []
    folders = [root]
    _collect(path, root, set(), references, folders)
    for file, tag, key, value in references:
        description = tag in _DESCRIPTIONS
        # relative to the main file, to the file itself (a model inside a model), or to a folder of assets
        near = [root, file.parent] if description or key in _FOLDERS else [*folders, file.parent]
        for target in {(folder / _plain(value)).resolve() for folder in near}:
            if target.is_relative_to(root):
                continue
            beside = not description and target.is_relative_to(home)
            if beside and (key in _FOLDERS or target.suffix.lower() in (*DATA, COLLADA)):
                continue
            place = (
                "the model's folder" if description else f"the model's folder and of {home.name}/ around it"
            )
            raise InputError(
                f"{file.name}: <{tag} {key}={value!r}> lies outside of {place}; copy what it names into the "
                "model's folder."
            )


def package_of(path: Path) -> Path:
    """The folder within which data may lie: the ROS package around a model, else the parent of its folder."""
    above = path.parent.parents[:_LEVELS]
    return next((f for f in (path.parent, *above) if (f / "package.xml").is_file()), path.parent.parent)


def _plain(value: str) -> str:
    return value.removeprefix("package://").removeprefix("file://")


def _collect(
    path: Path, root: Path, seen: set[Path], references: list[tuple[Path, str, str, str]], folders: list[Path]
) -> None:
    """Add the references of a description and of all that it includes: (file, tag, attribute, value)."""
    if path in seen:
        return
    seen.add(path)
    tree = _read(path)
    check_sizes(path.name, tree)
    for element in tree.iter():
        for key, value in element.items():
            if not value or not (key.startswith("file") or key in _FOLDERS):
                continue
            references.append((path, element.tag, key, value))
            if key in _FOLDERS:
                folders.append(root / _plain(value))
            elif element.tag in _DESCRIPTIONS and key == "file":
                inner = next((t for t in (root / value, path.parent / value) if t.is_file()), root / value)
                if inner.resolve().is_relative_to(root):
                    _collect(inner.resolve(), root, seen, references, folders)


def _read(path: Path) -> ET.Element:
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the model file {path.name}: {error.strerror or error}.") from None
    try:
        # By the parser, not by the text: an encoding may hide the words.
        declared = expat.ParserCreate()
        declared.StartDoctypeDeclHandler = partial(_refuse_declaration, path)
        declared.Parse(text, True)
        return ET.fromstring(text)
    except InputError:
        raise
    except expat.ExpatError as error:
        raise InputError(f"{path.name} is not well-formed XML ({error}); repair the file.") from None
    except ET.ParseError as error:
        raise InputError(f"{path.name} is not well-formed XML ({error}); repair the file.") from None
    except (ValueError, LookupError) as error:
        raise InputError(
            f"{path.name} has an encoding that cannot be read ({error}); save it as UTF-8."
        ) from None


def _refuse_declaration(path: Path, *_: object) -> None:
    raise InputError(f"{path.name} contains a DOCTYPE or ENTITY declaration; remove it.")


def read_spec(path: Path, text: bytes | None = None) -> mujoco.MjSpec:
    """The description in a file that was checked; the meshes of a URDF are found where ROS has them.

    Args:
        text: what the file is to contain, in place of what it does; MJCF then without `<include>`.
    """
    tree = _read(path) if text is None else ET.fromstring(text)
    if tree.tag != "robot" and text is None:
        if path.suffix.lower() != ".xml":
            raise InputError(f"MuJoCo reads MJCF from files that end in .xml; rename {path.name}.")
        return mujoco.MjSpec.from_file(str(path))
    if tree.tag != "robot" and text is not None:
        spec = mujoco.MjSpec.from_string(text.decode())
        spec.modelfiledir = f"{path.parent}{os.sep}"
        return spec
    if any("xacro" in e.tag or any("${" in value for value in e.attrib.values()) for e in tree.iter()):
        raise InputError(
            f"{path.name} holds macros of xacro; write them out first: xacro {path.name} > robot.urdf."
        )
    assets: dict[str, bytes] = {}
    folders = [path.parent]
    for compiler in tree.iter("compiler"):
        folders += [path.parent / compiler.attrib.pop(key) for key in _FOLDERS if key in compiler.attrib]
    for link in tree.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find(".//mesh")
            # what is only seen may be missing, or in a format that MuJoCo cannot read
            if mesh is not None and not _is_readable(path, folders, mesh.get("filename", "")):
                link.remove(visual)
    for mesh in tree.iter("mesh"):
        value = mesh.get("filename", "")
        content = _mesh(path, folders, value).read_bytes()
        name = Path(value).name
        while assets.get(name, content) != content:
            name = f"_{name}"
        assets[name] = content
        mesh.set("filename", name)
    return mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"), assets=assets)


def _is_readable(path: Path, folders: list[Path], value: str) -> bool:
    try:
        return _mesh(path, folders, value).is_file()
    except InputError:
        return False


def _mesh(path: Path, folders: list[Path], value: str) -> Path:
    """The file of a mesh. `package://NAME/rest` is looked for in the folders above that may be the package NAME."""
    home, plain = package_of(path), _plain(value)
    if Path(value).suffix.lower() == COLLADA:
        raise InputError(f"{path.name}: MuJoCo cannot read the mesh {value}; convert it to .stl or .obj.")
    tries = [folder / plain for folder in folders] + [folder / Path(value).name for folder in folders]
    if value.startswith("package://"):
        rest = Path(*Path(plain).parts[1:])
        around = [f for f in (path.parent, *path.parent.parents) if f.is_relative_to(home)]
        tries = [folder / part for folder in around for part in (rest, Path(plain))] + tries
    found = next((t.resolve() for t in tries if t.is_file()), None)
    if found is None or not found.is_relative_to(home) or found.suffix.lower() not in DATA:
        raise InputError(
            f"{path.name}: the mesh {value!r} is not in {home.name}/ around the model; copy it beside the model file."
        )
    return found
