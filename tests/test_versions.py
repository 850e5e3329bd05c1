"""What is pinned, what is declared and what is installed agree."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]
CONSTRAINTS = [
    Requirement(line)
    for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    if line and not line.startswith("#")
]
ENVIRONMENTS = [
    {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": platform}
    for python in ("3.11", "3.12", "3.13")
    for platform in ("linux", "darwin")
]


def applies(marker: Marker | None, environment: dict[str, str]) -> bool:
    return marker is None or marker.evaluate(environment)


def pinned(environment: dict[str, str]) -> dict[str, list[str]]:
    """The versions that constraints.txt gives each package in `environment`."""
    pins: dict[str, list[str]] = {}
    for requirement in CONSTRAINTS:
        if applies(requirement.marker, environment):
            pins.setdefault(canonicalize_name(requirement.name), []).append(str(requirement.specifier))
    return pins


@pytest.mark.parametrize(("package", "expected"), [("mujoco", "4.0.0"), ("mujoco-mjx", "3.17.0")])
def test_the_engine_pair_is_declared_pinned_and_installed(package, expected):
    declared = {Requirement(line).name: str(Requirement(line).specifier) for line in PROJECT["dependencies"]}
    assert declared[package] == f"=={expected}"
    assert all(pinned(environment)[package] == [f"=={expected}"] for environment in ENVIRONMENTS)
    assert version(package) == expected


@pytest.mark.parametrize(
    "environment", ENVIRONMENTS, ids=lambda e: f"{e['python_version']}-{e['sys_platform']}"
)
def test_every_declared_dependency_has_one_exact_pin_that_satisfies_it(environment):
    pins = pinned(environment)
    assert all(len(versions) == 1 for versions in pins.values())
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    for requirement in map(Requirement, (line for group in groups for line in group)):
        if requirement.name == PROJECT["name"] or not applies(requirement.marker, environment):
            continue
        (pin,) = pins[canonicalize_name(requirement.name)]
        assert re.fullmatch(r"==[^*,]+", pin)
        assert requirement.specifier.contains(pin.removeprefix("==")), f"{requirement} against {pin}"


def test_constraints_hold_versions_only():
    text = (ROOT / "constraints.txt").read_text("utf-8")
    assert "://" not in text
    assert all(requirement.url is None and not requirement.extras for requirement in CONSTRAINTS)


def test_one_version_of_this_project():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    newest = re.search(r"^## (\S+)", changelog, flags=re.MULTILINE)
    assert newest is not None
    assert citation["version"] == newest[1] == PROJECT["version"]
