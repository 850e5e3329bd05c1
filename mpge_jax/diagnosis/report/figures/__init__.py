"""Figures of a diagnosis: predicted motion or forces, where it lies, and the machine with its places marked."""
