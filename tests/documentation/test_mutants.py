"""The faults that `python -m tests.mutants` plants are still faults of this code."""

from pathlib import Path

import pytest

from tests.mutants import MUTANTS, ROOT, Mutant, planted


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.about)
def test_every_fault_can_be_planted(mutant: Mutant):
    text = (ROOT / mutant.file).read_text()
    assert planted(mutant, text) != text
    for test in mutant.tests:
        file, *names = test.partition("[")[0].split("::")
        written = Path(ROOT / file).read_text()
        assert all(f"def {name}(" in written or f"class {name}" in written for name in names), test
