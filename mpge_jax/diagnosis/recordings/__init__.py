"""Recordings: read, checked, split, and smoothed into states with their noise."""
