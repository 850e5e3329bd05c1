"""What the terminal says, from what `diagnosis.json` holds."""

from mpge_jax.diagnosis.report.terminal import summary


def entry(value: float, unit: str) -> dict:
    return {"value": value, "low": value - 0.01, "high": value + 0.01, "unit": unit}


TABLE = {
    "verdict": "effects",
    "explanation": "The elbow has dry friction. " * 6,
    "effects": [
        {
            "id": "stribeck_friction",
            "at": "elbow",
            "parameters": {"coulomb": entry(0.2, "N m"), "static": entry(0.3, "N m")},
            "error_drop": 0.75,
        },
        {
            "id": "payload_mass",
            "at": "hand\x1b[2J",
            "parameters": {"mass": entry(0.5, "kg")},
            "error_drop": 0.5,
        },
    ],
    "fit": {
        "unit": "rad",
        "window_s": 0.5,
        "held_out": {
            "recordings": ["run_7"],
            "before": 0.0382,
            "after": None,
            "per_joint": {"elbow": [0.0531, 0.00295], "wrist": [0.01, 0.02]},
        },
    },
    "ambiguous": [{"candidates": [], "separated_by": "move both ways at several speeds", "experiment": None}],
    "warnings": ["the clock of run_7 jumps."],
}


def test_verdict_effects_errors_and_warnings_stand_in_columns():
    text = summary(TABLE)
    lines = text.splitlines()
    assert lines[0].startswith("effects: The elbow has dry friction.") and max(map(len, lines)) <= 100
    table = [x for x in lines if "N m" in x or "kg" in x]
    assert [x.split()[0] for x in table] == ["stribeck_friction", "static", "payload_mass"]
    assert "0.20 N m" in table[0] and "0.19 to 0.21 N m" in table[0] and table[0].endswith("2 times")
    # one effect of two parameters is named once, and what it takes away told once
    assert table[1].index("static") == table[0].index("coulomb") and "times" not in table[1]
    (head,) = [x for x in lines if x.startswith("held-out error (rad)")]
    shown = (("elbow", "0.0531", "0.00295"), ("wrist", "0.01", "0.02"), ("all together", "0.0382", "unknown"))
    for name, given, corrected in shown:
        (row,) = [x for x in lines[lines.index(head) :] if x.startswith(name)]
        assert row.index(given) == head.index("model as given") and row.index(corrected) == head.index(
            "corrected"
        )
    assert "to tell them apart: move both ways at several speeds" in lines
    assert "(rms over 0.5 s pieces of run_7)" in lines and lines[-1] == "warning: the clock of run_7 jumps."


def test_what_a_terminal_would_obey_is_not_printed():
    assert "\x1b" not in summary(TABLE) and "hand?[2J" in summary(TABLE)


def test_nothing_is_said_of_effects_where_there_are_none():
    text = summary({**TABLE, "verdict": "none", "effects": [], "ambiguous": [], "warnings": []})
    assert (
        "interval" not in text and "apart" not in text and "warning" not in text and "model as given" in text
    )
