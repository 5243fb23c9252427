"""Discretisations: harmonic balance, shooting, the orbit they give, and its Floquet multipliers."""
