"""Logs as people have them: one module a format, each of which gives tables of columns without meaning for a model."""
