"""Every rule of the list is one of the engine's: its function, its numbers, and what is answered without it."""

import importlib
import inspect
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.ablation.gates import numbers
from experiments.ablation.replaced import ENGINE, _function, alike, watched, without
from experiments.ablation.rules import GATES, WORK, gate
from mpge_jax import diagnosis
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.evidence import paired_gains, scored
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.selection import all_joints, backward_elimination, criteria

EACH = pytest.mark.parametrize("each", GATES, ids=lambda g: g.name)
GAIN = np.array([0.1, 0.2, 0.1, 0.3, 40.0])


@EACH
def test_a_rule_is_a_function_of_the_engine_with_its_numbers(each):
    assert inspect.isfunction(_function(each.where))
    modules = [m for name, m in sys.modules.items() if name.startswith(ENGINE)]
    for name in each.numbers:
        assert any(hasattr(m, name) for m in modules) or name == "tier", name


def test_every_number_of_the_rooms_that_decide_belongs_to_a_rule_or_is_one_of_work():
    ruled, found = {n for g in GATES for n in g.numbers}, set()
    for room in ("selection", "evidence"):
        for path in sorted((Path(diagnosis.__file__).parent / room).glob("*.py")):
            module = f"{room}.{path.stem}"
            for name, value in vars(importlib.import_module(f"{ENGINE}.{module}")).items():
                own = re.search(rf"^[\w, ]*\b{name}\b[\w, ]* = ", path.read_text(), re.MULTILINE)
                if name.isupper() and own and isinstance(value, int | float):
                    found.add((module, name))
    unruled = {(module, name) for module, name in found if name not in ruled}
    assert unruled == {(module, name) for module, names in WORK.items() for name in names}
    assert len(found - unruled) <= 40


def test_names_are_told_once():
    assert len({g.name for g in GATES}) == len(GATES)
    with pytest.raises(ValueError, match="there is no rule 'nothing'"):
        gate("nothing")


@EACH
def test_without_a_rule_all_modules_have_the_substitute_and_then_the_rule_again(each):
    own, name = _function(each.where), each.where.split(":")[1]
    with without(each):
        assert _function(each.where) is not own
        for module in [m for n, m in sys.modules.items() if n.startswith(ENGINE)]:
            assert vars(module).get(name) is not own, module.__name__
    assert _function(each.where) is own


def test_who_imported_a_function_gets_its_substitute():
    importlib.import_module(f"{ENGINE}.selection.procedure")
    with without(gate("moves")):
        assert criteria.moves(None, None, None)
        assert backward_elimination.moves(None, None, None)
    with without(gate("significant")):
        assert all_joints.needed is criteria.needed


def test_a_number_is_another_one_within_the_function_alone():
    off = numbers(STRONG=1e9)
    assert paired_gains.strong(np.full(20, 2.0), np.full(40, 2.0))
    assert not off(paired_gains.strong, np.full(20, 2.0), np.full(40, 2.0))
    assert paired_gains.STRONG < 1e9


def test_gains_by_their_mean_alone():
    with without(gate("by ranks")):
        by_mean = paired_gains.deviations(GAIN)
    assert by_mean == pytest.approx(GAIN.mean() / (GAIN.std(ddof=1) / np.sqrt(5)))
    assert paired_gains.deviations(GAIN) > 2.0 > by_mean


def test_methods_are_given_their_object():
    floor = Floor(loss=1.0, error=0.01)
    slight = np.full(50, 1.2)
    assert not floor.exceeded(slight)
    with without(gate("structure")):
        assert floor.exceeded(slight)
    with without(gate("far windows")):
        assert not floor.far(np.full(50, 100.0))
    assert floor.far(np.full(50, 100.0))


def test_only_rules_that_changed_an_answer_have_acted():
    better = SimpleNamespace(loss=1.0, hypothesis=Hypothesis())
    with watched() as acted:
        assert not paired_gains.strong(np.zeros(5), np.zeros(5))
        assert scored.hopeful([better], 10.0) == [better]
        assert acted == set()
        assert paired_gains.strong(np.full(20, 2.0), np.full(40, 2.0))
    assert acted == {"strong"}


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (1.0, 1.0, True),
        (np.array([1.0]), np.array([2.0]), False),
        ([1, 2], [1], False),
        (SimpleNamespace(hypothesis="a"), SimpleNamespace(hypothesis="b"), False),
        (
            SimpleNamespace(fit=SimpleNamespace(hypothesis="a"), tied=True),
            SimpleNamespace(fit=SimpleNamespace(hypothesis="a"), tied=False),
            False,
        ),
        (None, None, True),
    ],
)
def test_answers_that_say_the_same(a, b, same):
    assert alike(a, b) is same
