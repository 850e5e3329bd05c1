"""The table of how a delta action model learns."""

import json

from experiments.methods import residual
from experiments.tuning import delta


def test_settings_are_measured_once_and_what_the_sweep_has_is_marked(tmp_path, monkeypatch, capsys):
    asked = []

    def trial(reach, discount):
        asked.append((reach, discount))
        return {
            "reach": reach,
            "discount": discount,
            "following": 10 * reach,
            "error": discount,
            "nothing": 1.5,
        }

    monkeypatch.setattr(delta, "trial", trial)
    page = tmp_path / "docs" / "delta.md"
    monkeypatch.setattr("sys.argv", ["delta", "--out", str(tmp_path / "delta"), "--page", str(page)])
    first = tmp_path / "delta" / "reach-0.5-discount-0.99.json"
    first.parent.mkdir()
    stored = {"reach": 0.5, "discount": 0.99, "following": 7.25, "error": 1.75, "nothing": 1.5}
    first.write_text(json.dumps(stored))
    assert delta.main() == 0
    assert asked == list(delta.SETTINGS[1:])
    text = page.read_text()
    assert "| 0.5 | 0.99 | 7.25 | 1.75 |" in text and "scores 1.50" in text
    assert text.count("**") == 2 + 8
    assert f"| **{residual.CONFIG.reach:g}** | **{residual.DISCOUNT:g}** | **10.00** | **0.30** |" in text


def test_what_the_sweep_has_is_among_the_settings():
    assert (residual.CONFIG.reach, residual.DISCOUNT) in delta.SETTINGS
