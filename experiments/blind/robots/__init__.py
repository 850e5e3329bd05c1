"""Nominal machines: arms, legs, movers, and those of the paper."""
