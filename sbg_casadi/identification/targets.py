"""What was measured: targets with tolerances, one kind of measurement each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["rms", "peak", "jump", "regime", "exponent"]
KINDS: tuple[Kind, ...] = ("rms", "peak", "jump", "regime", "exponent")

QUANTITIES = {"rms": ("rms",), "peak": ("height", "position"), "jump": ("position",), "exponent": ("exponent",)}


@dataclass(frozen=True, slots=True)
class Target:
    """Hold one measurement in one state.

    Attributes
    ----------
    name : str
        How reports call it.
    state : str
    kind : {"rms", "peak", "jump", "regime", "exponent"}
        ``rms``: root mean square of lambda about its mean at a frequency ratio, half backlashes. ``peak``: the largest
        RMS of the responses met in a sweep up and down over ``band``, its height, its frequency ratio, or both.
        ``jump``: frequency ratio at which a sweep jumps (a fold). ``regime``: "period-N", "periodic", "quasi-periodic"
        or "chaotic". ``exponent``: largest Lyapunov exponent per unit of time, 1/omega_n.
    at : float
        Frequency ratio of an rms, regime or exponent; NaN else.
    wanted : tuple of (quantity, value, tolerance)
        "rms", "height", "position" or "exponent"; empty for a regime.
    regime : str
        Empty but for a regime.
    band : (float, float)
        Frequency ratios that a peak or jump is looked for in.
    """

    name: str
    state: str
    kind: Kind
    at: float
    wanted: tuple[tuple[str, float, float], ...]
    regime: str = ""
    band: tuple[float, float] = (0.3, 2.6)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the residuals."""
        return tuple(f"{self.name}, {q}" if len(self.wanted) > 1 else self.name for q, _, _ in self.wanted) or (
            self.name,
        )


def regime_period(regime: str) -> int:
    """Return the period that a regime names, 0 for any, -1 where it names none.

    Examples
    --------
    >>> regime_period("period-10"), regime_period("periodic"), regime_period("chaotic")
    (10, 0, -1)
    """
    if regime == "periodic":
        return 0
    return int(regime.removeprefix("period-")) if regime.startswith("period-") else -1
