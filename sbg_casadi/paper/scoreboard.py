"""The scoreboard: all rows in one order, each key once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sbg_casadi.paper.equation_rows import equation_rows
from sbg_casadi.paper.open_rows import open_rows
from sbg_casadi.paper.row import Row
from sbg_casadi.paper.table_rows import table_rows

__all__ = ["Row", "scoreboard"]


def scoreboard(numbers: Mapping[str, Any] | None = None) -> list[Row]:
    """Return all rows of the scoreboard.

    Parameters
    ----------
    numbers : mapping, optional
        What the model gave, by case, see :func:`~sbg_casadi.paper.numbers.case_numbers`; without it the rows that
        need the model are left out.

    Raises
    ------
    ValueError
        If two rows have one key.

    Examples
    --------
    >>> from sbg_casadi.paper.row import counts
    >>> found = counts(scoreboard())
    >>> found["reproduced"] > 30, found["contradicted"] > 15, found["matched after calibration"]
    (True, True, 0)
    """
    rows = [*equation_rows(), *table_rows()]
    if numbers is not None:
        from sbg_casadi.paper.model_rows import model_rows

        rows += model_rows(numbers)
    rows += open_rows()
    _check(rows)
    return rows


def _check(rows: Sequence[Row]) -> None:
    seen: set[str] = set()
    for row in rows:
        if row.key in seen:
            raise ValueError(f"scoreboard: two rows are called {row.key!r}; expected different keys")
        seen.add(row.key)
