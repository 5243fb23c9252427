"""Errors a user can mend: the message is one sentence, and the command line ends with exit code 2."""

from __future__ import annotations


class UserError(ValueError):
    """An input or option the user gave can't be used; the message names it, its value and what was expected."""


class PairError(UserError):
    """A pair file can't be used.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> load_pair("iso-f3")
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.PairError: no built-in case and no file is called 'iso-f3'; did you mean 'iso-f2'?
    """
