"""Mismatch diagnosis: what physics does a MuJoCo model lack, according to recordings of the real machine?"""

from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.diagnosis import Diagnosis
from mpge_jax.diagnosis.effects import REGISTRY, VOCABULARY, Effect, register
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.own_effects import load_effects
from mpge_jax.diagnosis.pipeline import diagnose
from mpge_jax.diagnosis.recordings.formats.own_readers import load_readers, register_reader
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table
from mpge_jax.diagnosis.recordings.recording import Recording

__all__ = [
    "REGISTRY",
    "VOCABULARY",
    "Column",
    "Config",
    "Diagnosis",
    "Effect",
    "InputError",
    "Log",
    "Recording",
    "Table",
    "diagnose",
    "load_effects",
    "load_readers",
    "register",
    "register_reader",
]
