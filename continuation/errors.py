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
    orbit : Orbit or None
        The last good orbit, where there was one to start from.
    """

    def __init__(
        self,
        message: str,
        history: Iterable[float] = (),
        parameter: float | None = None,
        orbit: object | None = None,
    ) -> None:
        super().__init__(message)
        self.history = tuple(history)
        self.parameter = parameter
        self.orbit = orbit


class IntegrationFailed(ContinuationError):
    """An integration in the time domain could not be finished.

    Attributes
    ----------
    phase : float
        Excitation phase reached, in rad.
    parameters : dict of str to float
        All parameter values.
    """

    def __init__(self, message: str, phase: float, parameters: dict[str, float]) -> None:
        super().__init__(message)
        self.phase = phase
        self.parameters = parameters


class Runaway(IntegrationFailed):
    """The state leaves the finite numbers."""


class Chattering(IntegrationFailed):
    """Contacts open and close again and again without the integration advancing."""


class TooManySteps(IntegrationFailed):
    """The allowed steps do not suffice: the model is too stiff, or the tolerance too tight."""


class RestingContact(IntegrationFailed):
    """A contact argument rests on a breakpoint, where the force law has a corner and the flow no derivative."""


class GrazingContact(IntegrationFailed):
    """A contact argument only touches a breakpoint, where second derivatives of the flow are infinite."""


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
