"""The paper redone: every figure, table entry and checkable sentence with this project's value and a verdict."""

from sbg_casadi.paper.scoreboard import Row, scoreboard

__all__ = ["Row", "scoreboard"]
