"""What the pages of the documentation say is so: commands are understood, links and names exist, effects are drawn."""

import importlib
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tyro

from experiments import diagnose, facts, inspect, new, pretrain, sweep
from experiments.ablation import __main__ as ablation
from experiments.atlas import __main__ as atlas
from experiments.benchmark import __main__ as benchmark
from experiments.benchmark.peers import __main__ as peers
from experiments.blind import __main__ as blind
from experiments.demo import __main__ as demo
from experiments.fleet import __main__ as fleet
from experiments.results import grounded_returns, heat_map
from experiments.results import page as results
from experiments.scale import __main__ as scale
from experiments.second_author import __main__ as second_author
from experiments.tuning import search as tuning
from experiments.tuning import vine
from mpge_jax.diagnosis.effects import REGISTRY, VOCABULARY

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
BY_TYRO = {
    "demo": demo.Args, "sweep": sweep.Args, "benchmark": benchmark.Args, "results": results.Args,
    "pretrain": pretrain.Args, "new": new.Args, "facts": facts.Args, "tuning": tuning.Args, "fleet": fleet.Args,
    "tuning.vine": vine.Args,
    "scale": scale.Command, "blind": blind.Command, "benchmark.peers": peers.Args,
    "atlas": atlas.Args, "results.heat_map": heat_map.Args, "ablation": ablation.Command,
    "results.grounded_returns": grounded_returns.Args, "second_author": second_author.Command,
}  # fmt: skip
BY_ARGPARSE = {"diagnose": diagnose, "inspect": inspect}
NUMBER = re.compile(r"\d+(?:\.\d+)?")
STANDS_FOR = {"TASK": "Hopper", "KIND": "MS", "N": "4", "R": "ray"}


def commands() -> Iterator[tuple[str, str, list[str]]]:
    """Page, what Python is to run, and its arguments."""
    for page in PAGES:
        text = page.read_text("utf-8")
        for what, rest in re.findall(r"python (-m [\w.]+|docs/\w+\.py)([^`\n]*)", text):
            arguments = shlex.split(rest.partition("#")[0].partition("-->")[0])
            yield page.name, what.removeprefix("-m "), [STANDS_FOR.get(a, a) for a in arguments]


def test_every_command_is_understood():
    seen = set()
    for page, what, arguments in commands():
        seen.add(what)
        name = what.removeprefix("experiments.")
        where = f"{page}: {what} {' '.join(arguments)}"
        if not arguments and name in {**BY_TYRO, **BY_ARGPARSE}:
            continue  # a tool that is mentioned
        if name in BY_TYRO:
            assert tyro.cli(BY_TYRO[name], args=arguments) is not None, where
        elif name in BY_ARGPARSE:
            if "--list-effects" not in arguments:
                BY_ARGPARSE[name].parser().parse_args(arguments)
        elif what == "pytest":
            paths = [a for a in arguments if "/" in a]
            assert all((ROOT / a.partition("::")[0]).exists() for a in paths), where
        else:
            file = what if what.endswith(".py") else what.replace(".", "/") + ".py"
            package = ROOT / what.replace(".", "/") / "__main__.py"
            assert (ROOT / file).is_file() or package.is_file(), where
    assert {"experiments.demo", "experiments.diagnose", "experiments.sweep", "docs/draw_report.py"} <= seen


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_links_targets_extras_and_scripts_exist(page):
    text = page.read_text("utf-8")
    for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text):
        generated = page.parent.name == "docs" and target == "effects.md"
        assert generated or (page.parent / target).exists(), f"{page.name} links to {target}"
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:`|^ {4})make ([a-z-]+)", text, re.MULTILINE)) <= targets
    for extra in re.findall(r"pip install -e ['\"]\.\[(\w+)\]", text):
        assert extra in PROJECT["optional-dependencies"]
    assert set(re.findall(r"`(mpge-\w+)`", text)) <= set(PROJECT["scripts"])


def test_numbers_on_the_order_of_the_methods_stand_in_the_results():
    """A cell that is run again changes the table, which is generated, and this page, which is not."""
    told, table = (
        (ROOT / "docs" / name).read_text("utf-8") for name in ("ordering.md", "results-standard.md")
    )
    known = set(NUMBER.findall(table.replace(",", "")))
    numbers = [n.replace(",", "") for n in re.findall(r"\d{1,3}(?:,\d{3})+|\d+\.\d+|\d{3,}", told)]
    assert len(numbers) > 40
    assert not set(numbers) - known


def test_every_page_is_reached_from_the_navigation():
    named = set(re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    pages = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert named == pages | {"index.md", "effects.md"}


@pytest.fixture
def signatures(monkeypatch):
    """The module that draws what effects do."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    import signatures

    return signatures


def test_every_effect_is_drawn_and_says_what_it_is_confused_with(signatures):
    assert set(signatures.SIZES) == set(VOCABULARY)
    for name in VOCABULARY:
        others = REGISTRY[name].confused_with
        assert others and set(others) <= set(VOCABULARY) - {name}, name


def test_signatures_show_the_torque_that_is_missing(signatures):
    row = {"id": "coulomb_friction", "at": "hinge", "kind": "joint", "parameters": {"torque": 0.3}}
    t = signatures.trace([row])
    for sign in (1, -1):
        moving = sign * t.velocity > 1.0
        assert moving.sum() > 20
        assert np.median(t.missing[moving]) == pytest.approx(-0.3 * sign, abs=0.02)
    text = signatures.signature("contact_stiffness")
    assert text.count("<polyline") == 2 and "height (m)" in text and "nan" not in text


@pytest.mark.parametrize("name", [*BY_TYRO, "tuning.delta"])
def test_help_names_its_command_and_every_default_once(name, monkeypatch, capsys):
    module = importlib.import_module(f"experiments.{name}")
    if hasattr(module, "__path__"):
        module = importlib.import_module(f"experiments.{name}.__main__")
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit):
        (module.command if name == "pretrain" else module.main)()
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert said.startswith(f"usage: python -m experiments.{name} ")
    for odd in ("(default: )", ") (default:", "Attributes:", "Command line."):
        assert odd not in said


def test_the_page_of_the_api_has_what_other_pages_tell_to_import():
    listed = set(re.findall(r"^::: (\S+)$", (ROOT / "docs" / "api.md").read_text("utf-8"), re.MULTILINE))
    text = "".join(page.read_text("utf-8") for page in PAGES if page.name != "api.md")
    told = {f"envs.{name}" for name in re.findall(r"`envs\.(as_\w+)\(", text)}
    told |= set(re.findall(r"`(mpge_jax\.recorded\.\w+\.\w+)`", text))
    for names in re.findall(r"^from mpge_jax\.diagnosis import (.+)$", text, re.MULTILINE):
        told |= {f"mpge_jax.diagnosis.{name.strip()}" for name in names.split(",")}
    told |= {f"mpge_jax.diagnosis.{name}" for name in ("VOCABULARY", "REGISTRY", "load_readers")}
    told |= {"mpge_jax.rollouts.policies.shipped", "mpge_jax.sharding.mesh", "envs.State"}
    assert told <= listed, told - listed
