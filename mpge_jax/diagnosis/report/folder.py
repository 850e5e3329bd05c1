"""The files of a diagnosis: the two tables, the two models, a patch of the given one, figures and `report.html`."""

from __future__ import annotations

import json
from pathlib import Path

from mpge_jax import files
from mpge_jax.diagnosis.corrected.env_file import write_env
from mpge_jax.diagnosis.corrected.mjcf import write_models
from mpge_jax.diagnosis.corrected.patch import write_patch
from mpge_jax.diagnosis.report.figures.every_figure import draw
from mpge_jax.diagnosis.report.html_page import page
from mpge_jax.diagnosis.report.next_experiment import design
from mpge_jax.diagnosis.report.tables import diagnosis_table, effects_table
from mpge_jax.diagnosis.verdict.result import Result, ties_of


def write(d: Result, folder: Path) -> None:
    """Write every file; the folder is made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    experiment = design(d, {terms[0]: fits for terms, fits in ties_of(d)}, folder / "next_experiment.npz")
    table, effects = diagnosis_table(d, experiment), effects_table(d)
    files.write_text(folder / "effects.json", json.dumps(effects, indent=1, allow_nan=False))
    models = write_models(d, folder)
    write_patch(d, folder)
    write_env(d, folder)
    figures = draw(d, folder / "figures")
    files.write_text(folder / "report.html", page(d, table, effects, figures, experiment, models))
    files.write_text(folder / "diagnosis.json", json.dumps(table, indent=1, allow_nan=False))
