"""What the paper prints, as data: tables, captions, and the numbers of its sentences. Nothing here is computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["before", "after"]

CASES = ("case1", "case2", "case3", "case4")


@dataclass(frozen=True, slots=True)
class PairTable:
    """One of Tables 2 to 5; lengths in mm, torque in N m, angles in degrees, all with the digits that are printed.

    Attributes
    ----------
    number : int
        Of the table.
    teeth : (int, int)
        Pinion, gear.
    module, pressure_angle, backlash, torque : str
    base_radius : (str, str)
        "Base circle radius" of pinion and gear.
    """

    number: int
    teeth: tuple[int, int]
    module: str
    base_radius: tuple[str, str]
    pressure_angle: str
    backlash: str
    torque: str


PAIRS = {
    "case1": PairTable(2, (14, 41), "3.105", ("20.3", "119.62"), "20", "0.150", "250"),
    "case2": PairTable(3, (15, 44), "5.8", ("43.5", "119.90"), "20", "0.3", "260"),
    "case3": PairTable(4, (23, 65), "3.9", ("42.14", "119.10"), "20", "0.7", "1000"),
    "case4": PairTable(5, (23, 65), "7", ("75.65", "213.78"), "20", "0.7", "20000"),
}

METHOD = {"case1": "topology", "case2": "topology", "case3": "flank", "case4": "flank"}
"""Table 1."""

YEARS = {"case1": (2010, 2010), "case2": (2014, 2014), "case4": (2020, 2020)}
"""Year of the source of a case in Table 1 and in section 1, where that names one."""

AMPLITUDES = {
    "case1": ("0.1", "0.08", "20"),
    "case2": ("0.12", "0.11", "8.33"),
    "case3": ("0.68", "0.21", "69.12"),
    "case4": ("0.34", "0.28", "17.65"),
}
"""Table 7: largest amplitude before, after, and the reduction in percent."""

EXPONENTS: tuple[tuple[State, str, str, str], ...] = (
    ("after", "1.10", "1.10", "-0.0015"),
    ("after", "1.95", "1.95", "+0.046"),
    ("after", "2.10", "2.10", "+0.085"),
    ("after", "2.30", "2.30", "+0.009"),
    ("before", "0.6", "0.6", "-0.0045"),
    ("before", "Case 2", "1.11", "+0.087"),
    ("before", "Case 3", "1.7", "+0.068"),
    ("before", "Case 4", "2.30", "+0.047"),
)
"""Table 6: state, heading as printed, frequency ratio by the text of Figure 13, exponent."""

PEAKS: dict[str, tuple[str, tuple[State, ...]]] = {
    "case1": ("1.5", ("before", "after")),
    "case2": ("1.9", ("before", "after")),
    "case3": ("1.4", ("before",)),
    "case4": ("", ()),
}
"""Frequency ratio of the largest RMS and for which states it is told, text of Figures 7, 9, 12."""


@dataclass(frozen=True, slots=True)
class Regime:
    """One statement of the paper about the motion at a frequency ratio.

    Attributes
    ----------
    case, state : str
    low, high : str
        Range of the frequency ratio as printed; both the same for one frequency.
    motion : str
        ``periodic`` (any period), ``period-1``, ``period-2``, ``period-10`` or ``chaotic``.
    place : str
    """

    case: str
    state: State
    low: str
    high: str
    motion: str
    place: str


REGIMES = (
    Regime("case3", "before", "0.6", "0.6", "period-1", "Figure 13, region 1"),
    Regime("case3", "before", "1.11", "1.11", "chaotic", "Figure 13, region 2"),
    Regime("case3", "before", "1.7", "1.7", "chaotic", "Figure 13, region 3"),
    Regime("case3", "before", "2.30", "2.30", "chaotic", "Figure 13, region 4"),
    Regime("case3", "after", "0.6", "0.6", "periodic", "Figure 14, region 1"),
    Regime("case3", "after", "1.10", "1.10", "period-2", "Figure 15"),
    Regime("case3", "after", "1.95", "1.95", "chaotic", "Figure 15"),
    Regime("case3", "after", "2.10", "2.10", "chaotic", "Figure 15"),
    Regime("case3", "after", "2.30", "2.30", "chaotic", "Figure 15"),
    Regime("case4", "before", "0.3", "0.4", "periodic", "Figure 17, first region"),
    Regime("case4", "before", "0.45", "0.45", "chaotic", "Figure 18"),
    Regime("case4", "after", "0.3", "0.4", "periodic", "Figure 19, first region"),
    Regime("case4", "after", "0.45", "0.45", "period-10", "Figure 20"),
)

CAPTIONS = {
    7: ("RMS", "case1"),
    8: ("bifurcation", "case1"),
    9: ("RMS", "case2"),
    10: ("bifurcation", "case2"),
    11: ("bifurcation", "case2"),
    12: ("RMS", "case3"),
    13: ("bifurcation", "case3"),
    14: ("bifurcation", "case3"),
    16: ("RMS", "case4"),
    17: ("bifurcation", "case4"),
    19: ("bifurcation", "case4"),
}
"""What the captions say: kind of diagram and case."""

REFERENCES = (
    ("RMS", "case1", 7),
    ("bifurcation", "case1", 8),
    ("RMS", "case2", 8),
    ("RMS", "case2", 9),
    ("bifurcation", "case2", 10),
    ("RMS", "case3", 11),
    ("bifurcation", "case3", 12),
    ("bifurcation", "case3", 13),
    ("bifurcation", "case3", 14),
    ("RMS", "case4", 16),
    ("bifurcation", "case4", 17),
    ("bifurcation", "case4", 19),
)
"""What the text of section "Numerical Results" says is shown in which figure."""

HARMONICS = {"(21)": 7, "section 4": 5}
"""Number of harmonics of the mesh stiffness; the text before (17) has (N_p - 1)/2 without N_p."""

ERROR_COEFFICIENTS, STIFFNESS_COEFFICIENTS = 1, 2
"""Different coefficients of each harmonic of (16), (17)."""

EQUATIONS = {
    "z_p": (24, -1, "a3", 2),
    "z_g": (25, +1, "a3", 1),
    "y_p": (26, -1, "a2", 2),
    "y_g": (27, +1, "a2", 2),
    "x_p": (28, +1, "a1", 2),
    "x_g": (29, -1, "a1", 2),
}
"""Right-hand sides: number, sign, direction cosine, and the factor of the damping term, by coordinate."""

FORCES = {
    "z_p": (1, -1, "a3"),
    "z_g": (2, +1, "a3"),
    "y_p": (3, -1, "a2"),
    "y_g": (4, +1, "a2"),
    "x_p": (5, +1, "a1"),
    "x_g": (6, -1, "a1"),
    "theta_g": (7, +1, "r_g a3"),
    "phi_p": (8, -1, "r_p a3"),
}
"""Right-hand sides of (1)-(8): number, sign, and what multiplies F_n; -T_l and T_m come on top in (7), (8)."""


CLAIMED_REDUCTIONS = (
    ("Abstract", "case3", "68"),
    ("Discussion", "case1", "20"),
    ("Discussion", "case2", "8.3"),
    ("Discussion", "case3", "69"),
    ("Conclusions", "case1", "20"),
    ("Conclusions", "case2", "8"),
    ("Conclusions", "case3", "69"),
    ("Conclusions", "case4", "17"),
)
"""Percentages of the sentences; the abstract does not name the case, and Table 7 has nothing nearer."""

CLAIMED_AMPLITUDES = (
    ("text of Figure 7", "case1", "before", "0.10"),
    ("text of Figure 7", "case1", "after", "0.08"),
)

MOTION_AS_TOLD: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "case1": (("periodic",), ("periodic",)),
    "case2": (("periodic",), ("periodic",)),
    "case3": (("periodic", "chaotic", "chaotic", "chaotic"), ("periodic", "periodic", "chaotic", "chaotic", "chaotic")),
    "case4": (("periodic", "chaotic"), ("periodic", "periodic")),
}
"""Motions that the text reports for each case before and after; case 3 by Figures 13 to 15 and Table 6."""

IMPROVES_MOTION = {
    "Discussion": {"topology": False, "flank": True},
    "Conclusions, before the list": {"topology": True, "profile": False},
    "Conclusions, list": {"topology": False, "flank": True},
}
"""Whether a kind of modification is said to improve the qualitative motion, and where."""


def digits_unit(text: str) -> float:
    """Return one unit in the last printed digit of a number, the tolerance of a comparison with it.

    A correctly rounded number is within half of that, one that is cut off within all of it.

    Examples
    --------
    >>> digits_unit("119.62"), digits_unit("250"), digits_unit("+0.046")
    (0.01, 1.0, 0.001)
    """
    digits = text.partition(".")[2]
    return float(f"1e-{len(digits)}")
