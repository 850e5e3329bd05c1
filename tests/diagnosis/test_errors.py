"""An error of the user's input is one line, whatever the input was called."""

from __future__ import annotations

import pytest

from mpge_jax.diagnosis import InputError


@pytest.mark.parametrize(
    ("name", "told"),
    [("a\nb", r"a\nb"), ("\r\x1b[31m", r"\r\x1b[31m"), ("\u2028", r"\u2028"), ("Küche µ", "Küche µ")],
)
def test_what_cannot_be_printed_is_escaped(name, told):
    assert str(InputError(f"there is no '{name}'.")) == f"there is no '{told}'."
