"""What `diagnose` returns: the result, with what people do with one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from mpge_jax.diagnosis.verdict.result import Result


class Diagnosis(Result):
    """A `Result` that writes itself and rebuilds its machine; all numbers are in SI units, angles in radians."""

    def __repr__(self) -> str:
        named = [str(term) for term in self.named]
        said = f"warnings={len(self.warnings)}, seconds={self.seconds:.0f}"
        return f"Diagnosis({self.verdict!r}, effects={named}, {said})"

    def __str__(self) -> str:
        """The verdict in sentences, and the warnings."""
        from mpge_jax.diagnosis.report.sentences import explanation

        return "\n".join([f"{self.verdict}: {explanation(self)}", *(f"warning: {w}" for w in self.warnings)])

    def corrected_spec(self) -> mujoco.MjSpec:
        """The nominal description with native forms of the effects added."""
        from mpge_jax.diagnosis.corrected.mjcf import corrected_spec

        return corrected_spec(self)[0]

    def corrected_model(self) -> mujoco.MjModel:
        """Compiled model with all effects that MuJoCo has natively; `effects()` holds the others too."""
        return self.corrected_spec().compile()

    def corrected_env(self, task: str | None = None, backend: str = "auto") -> Any:
        """The corrected machine (`CorrectedModel`); with the name of a task, that task's `envs.Env` in it, on a backend
        `c`, `mjx`, or `auto` (`c` on a CPU, else `mjx`)."""
        from mpge_jax.diagnosis.corrected.tasks import corrected_env

        return corrected_env(self.prepared.spec, self.effects()["effects"], task, backend)

    def effects(self) -> dict[str, Any]:
        """All effects in the form from which `CorrectedModel` rebuilds them: the contents of `effects.json`."""
        from mpge_jax.diagnosis.report.tables import effects_table

        return effects_table(self)

    def to_json(self) -> dict[str, Any]:
        """The contents of `diagnosis.json`."""
        from mpge_jax.diagnosis.report.tables import diagnosis_table

        return diagnosis_table(self)

    def write(self, folder: str | Path) -> None:
        """Write `diagnosis.json`, `corrected.xml`, `effects.json`, figures and `report.html`."""
        from mpge_jax.diagnosis.report.folder import write

        write(self, Path(folder))
