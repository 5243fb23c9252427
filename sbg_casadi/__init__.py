"""Spiral bevel gear pairs: pair files, derived quantities and the symbolic equations of the seven-coordinate model.

Every public name is imported on first use, so that importing the package (as the command line does for ``--help``)
loads none of CasADi, NumPy, pydantic and pint.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sbg_casadi.derived import Derived
    from sbg_casadi.dimensionless import Dimensionless
    from sbg_casadi.errors import PairError, UserError
    from sbg_casadi.identification import identify
    from sbg_casadi.model import gear_system, static_state
    from sbg_casadi.pair import Pair, case_names, load_pair

_HOME = {
    "Derived": "derived",
    "Dimensionless": "dimensionless",
    "Pair": "pair",
    "PairError": "errors",
    "UserError": "errors",
    "case_names": "pair",
    "gear_system": "model",
    "identify": "identification",
    "load_pair": "pair",
    "static_state": "model",
}

__all__ = [
    "Derived",
    "Dimensionless",
    "Pair",
    "PairError",
    "UserError",
    "case_names",
    "gear_system",
    "identify",
    "load_pair",
    "static_state",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sbg_casadi' has no attribute {name!r}")
    return getattr(import_module(f"sbg_casadi.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
