"""Errors that the engine raises: misuse is ``ValueError``, failed numerics are ``ContinuationError``."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class ContinuationError(Exception):
    """A numerical method could not do what was asked; the message says why and what to change."""


class NoConvergence(ContinuationError):
    """Newton's method did not converge.

    Attributes
    ----------
    history : tuple of float
        Norm of the residual at every iteration.
    parameter : float or None
        Continuation parameter at which it failed.
    """

    def __init__(self, message: str, history: Iterable[float] = (), parameter: float | None = None) -> None:
        super().__init__(message)
        self.history = tuple(history)
        self.parameter = parameter


class SingularLinearPart(ContinuationError):
    """The linear part of a System has an undamped mode on a harmonic that the nonlinear ports can't reach."""


class UnsupportedModel(ContinuationError):
    """A System has a structure that the chosen method does not treat; the message names one that does."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the sentence fragment that lists the names nearest to an unknown one.

    >>> nearest("omgea", ["omega", "g"])
    "did you mean 'omega'?"
    """
    options = list(known)
    close = difflib.get_close_matches(name, options, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "known: " + ", ".join(repr(o) for o in options)
