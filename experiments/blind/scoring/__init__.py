"""Answers beside what a diagnosis said."""
