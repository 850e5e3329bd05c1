"""Every rule of the list is one of the engine's: its function, its numbers, and what is answered without it."""

import ast
import importlib
import inspect
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.ablation.gates import numbers
from experiments.ablation.replaced import ENGINE, _function, alike, watched, without
from experiments.ablation.rules import GATES, WORK, gate
from mpge_jax import diagnosis
from mpge_jax.diagnosis import thresholds
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence import likelihood_ratio, scored
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.scored import Scored
from mpge_jax.diagnosis.selection import all_joints, backward_elimination, criteria

EACH = pytest.mark.parametrize("each", GATES, ids=lambda g: g.name)
GAIN = np.array([0.1, 0.2, 0.1, 0.3, 40.0])
BETTER_AND_WORSE = [Scored(NOTHING, np.full(10, x), np.full(10, x), 0, 0) for x in (1.0, 30.0)]


@EACH
def test_a_rule_is_a_function_of_the_engine_with_its_numbers(each):
    assert inspect.isfunction(_function(each.where))
    assert set(each.numbers) <= set(_numbers(thresholds))


@EACH
def test_a_substitute_takes_what_its_function_takes(each):
    own = _function(each.where)
    given = [p for p in inspect.signature(own).parameters.values() if p.default is p.empty]
    assert all(p.kind is p.POSITIONAL_OR_KEYWORD for p in given)
    inspect.signature(each.off).bind(own, *given)
    if each.acted is not None:
        inspect.signature(each.acted).bind("answer", *given)


def test_every_number_that_decides_stands_in_one_place_and_belongs_to_a_rule():
    assert set(_numbers(thresholds)) == {n for g in GATES for n in g.numbers}
    assert len(_numbers(thresholds)) <= 40


def test_no_other_number_of_the_rooms_that_decide_decides_anything():
    found = {}
    for room in ("selection", "evidence"):
        for path in sorted((Path(diagnosis.__file__).parent / room).glob("*.py")):
            module = f"{room}.{path.stem}"
            names = _numbers(importlib.import_module(f"{ENGINE}.{module}"))
            if names:
                found[module] = tuple(names)
    assert found == WORK


def _numbers(module):
    """Names of the numbers that a module defines, in their order."""
    assigned = [n for n in ast.parse(inspect.getsource(module)).body if isinstance(n, ast.Assign)]
    names = [x.id for n in assigned for t in n.targets for x in ast.walk(t) if isinstance(x, ast.Name)]
    return [n for n in names if isinstance(getattr(module, n), int | float)]


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
    with without(gate("sure")):
        assert all_joints.needed is criteria.needed


def test_a_number_is_another_one_within_the_function_alone():
    off = numbers(SURE=1e13)
    assert likelihood_ratio.beyond_doubt(10.0)
    assert not off(likelihood_ratio.beyond_doubt, 10.0)
    assert likelihood_ratio.SURE < 1e13


def test_gains_by_their_mean_alone():
    with without(gate("by ranks")):
        by_mean = likelihood_ratio.deviations(GAIN)
    assert by_mean == pytest.approx(GAIN.mean() / (GAIN.std(ddof=1) / np.sqrt(5)))
    assert likelihood_ratio.deviations(GAIN) > 2.0 > by_mean


def test_methods_are_given_their_object():
    floor = Floor(loss=1.0, error=0.1, losses=np.ones(20))
    slight = np.full(50, 1.2)
    assert not floor.exceeded(slight)
    with without(gate("doubt")):
        assert floor.exceeded(slight)
    with without(gate("far windows")):
        assert not floor.far(np.full(50, 100.0))
    assert floor.far(np.full(50, 100.0))


def test_only_rules_that_changed_an_answer_have_acted():
    one, (new, old) = SimpleNamespace(loss=1.0, hypothesis=Hypothesis()), BETTER_AND_WORSE
    with watched() as acted:
        assert criteria.needed(new, old)
        assert scored.hopeful([one], 10.0) == [one]
        assert acted == set()
        assert not criteria.needed(old, new)
    assert acted == {"sure"}


def test_a_bound_of_the_ratio_has_acted_only_where_it_changed_what_anything_asks_for():
    with watched() as acted:
        likelihood_ratio.log_ratio(np.array([1000.0, 900.0, 1100.0]))
        likelihood_ratio.log_ratio(np.array([-0.5, -0.4, -0.6]))
        assert acted == set()
        likelihood_ratio.log_ratio(np.array([1.5, 1.4, 1.6]))
        assert acted == {"by size"}
        likelihood_ratio.log_ratio(np.array([40.0, 0.0, 0.0, 0.0, 0.0]))
    assert acted == {"by size", "by scatter"}


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
