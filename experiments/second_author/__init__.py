"""Thirty cases by a second author, who wrote machines and hidden physics without having read the engine.

They are written in the format of `experiments.blind`, whose commands run and score them, and share no code with it.
"""
