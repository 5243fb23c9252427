"""Continuation: corrected steps along a branch, its special points, and the branch that results."""
