"""The rows of the ledger as data, in the words of this project; measured effects are in half backlashes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """Hold one misprint or gap of the source.

    Attributes
    ----------
    number : int
    place : str
        Equations, tables or figures; numbers in brackets are equations.
    printed, consistent : str
        What stands there, and what is used instead.
    effect : str
        What the row changes, in words.
    """

    number: int
    place: str
    printed: str
    consistent: str
    effect: str


@dataclass(frozen=True, slots=True)
class Measurement:
    """Hold the outcome of one traced response.

    Attributes
    ----------
    peak_rms : float
        Largest RMS of lambda about its mean, half backlashes.
    points : tuple of (str, float)
        Kind and frequency ratio of the located special points, rising.
    """

    peak_rms: float
    points: tuple[tuple[str, float], ...]


ROWS = (
    LedgerRow(
        1,
        "(9), (10)",
        "a1 = sin(al) sin(de) + sin(al) sin(be) cos(de), a2 = sin(al) cos(de) + cos(al) sin(be) sin(de)",
        "a1 = sin(al) sin(de) + s cos(al) sin(be) cos(de), a2 = sin(al) cos(de) - s cos(al) sin(be) sin(de), with "
        "s = +1 or -1 for hand of spiral and driving flank",
        "the squares of a1, a2, a3 sum to 1; as printed to 0.928 for 14/41 teeth, 20 and 35 deg",
    ),
    LedgerRow(
        2,
        "(12)",
        "mesh damping on lambda'",
        "mesh damping on lambda' - e'",
        "no difference while e = 0",
    ),
    LedgerRow(
        3,
        "(16)",
        "one coefficient ea_j on cosine and sine",
        "ea_j on the cosine, eb_j on the sine",
        "no difference while e = 0",
    ),
    LedgerRow(
        4,
        "(17), (21), text",
        "(N_p - 1)/2 harmonics, seven harmonics, and a fifth-order series",
        "as many harmonics as the pair file gives; a table of N_p samples allows (N_p - 1)/2",
        "changes no number: the pair file decides",
    ),
    LedgerRow(
        5,
        "(7), (8), (14), tables",
        "base radius at the mid-section",
        "mean pitch radius: the factor a3 already holds cos(al)",
        "a base radius counts cos(al) twice, 6.4 % in F_n at 20 deg; settled in the case files",
    ),
    LedgerRow(
        6,
        "Table 2",
        "gear 119.62 mm, pinion 20.3 mm",
        "base radii of 59.81 mm and 20.42 mm",
        "119.62 mm is a diameter; settled in the case files, which derive the radii",
    ),
    LedgerRow(
        7,
        "Table 3",
        "pinion 43.5 mm",
        "base radius of 40.88 mm",
        "43.5 mm is the pitch radius; settled in the case files, which derive the radii",
    ),
    LedgerRow(
        8,
        "tables",
        "radii m z cos(al)/2 of the outer end",
        "outer radius times R_m/R_e",
        "a factor of 0.85 for a face width of 0.3 R_e; settled in the case files",
    ),
    LedgerRow(
        9,
        "tables",
        "a torque without the member it acts on",
        "the pair file names the member",
        "a factor z2/z1 in the load; 20 kN m on the pinion of case 4 would be 5.2 kN per mm of face width, so the gear "
        "is meant",
    ),
    LedgerRow(
        10,
        "Tables 4, 5",
        "backlash of 0.7 mm, without its plane",
        "kept and flagged; b is half of it at the mean cone distance, and the pair file names the plane",
        "18 % and 10 % of the module, where 3 to 6 % are usual; scales load and amplitude",
    ),
    LedgerRow(
        11,
        "(23)",
        "T_m alone drives lambda",
        "balanced torques, T_l/r_g = T_m/r_p",
        "changes no number: without balance the speed drifts and K(t) is not periodic, which is refused",
    ),
    LedgerRow(
        12,
        "(25)",
        "damping C_g lambda' without the factor 2",
        "2 C_g lambda', as in (24), (26)-(29) and by (22)",
        "as printed, mesh damping on z_g halves and virtual work is violated",
    ),
    LedgerRow(
        13,
        "(22)",
        "lambda'' and lambda' relate barred to unbarred quantities; K_p(t) and K_g(t) keep k(t) in N/m",
        "lengths over b, time omega_n t, K_p = K(t) m_eq/m_p and K_g = K(t) m_eq/m_g",
        "changes no number: only one choice has consistent units",
    ),
    LedgerRow(
        14,
        "K_m from a graph of the transmission error",
        "K_m = F_n / TE",
        "k = F_n / (loaded TE - unloaded TE); the unloaded TE goes into e",
        "counts the unloaded TE twice as printed; concerns data files, not the equations",
    ),
    LedgerRow(
        15,
        "RMS figures",
        "peaks of 0.08 to 0.68, though contact needs lambda > 1",
        "RMS of lambda minus its mean",
        "changes no orbit: a definition of what is plotted",
    ),
    LedgerRow(
        16,
        "Table 6",
        "a garbled header",
        "frequency ratios before 0.60, 1.11, 1.70, 2.30 and after 1.10, 1.95, 2.10, 2.30",
        "changes no number: names the columns to compare with",
    ),
    LedgerRow(
        17,
        "Table 6",
        "exponents of -0.0015 and -0.0045 for periodic states",
        "ln |leading multiplier| per period, near zero only beside a bifurcation or with tiny damping",
        "changes no number: not checkable without the missing parameters",
    ),
    LedgerRow(
        18,
        "abstract, conclusions",
        "68, 69 and 17 %; three modifications that prevent chaos; topology and flank exchanged",
        "20.00, 8.33, 69.12 and 17.65 % of Table 7; cases 1 and 2 are periodic before and after",
        "changes no number: the targets of the comparison are those of Table 7",
    ),
    LedgerRow(
        19,
        "(16)",
        "forward and reverse error as two branches of one e(t)",
        "one choice for each run",
        "kept and flagged: on the coast flank s, a1, a2 and lambda would differ, and one lambda is used",
    ),
    LedgerRow(
        20,
        "missing",
        "no masses, inertias, bearings, xi, k_0, a_j, b_j, e, be, de, face width, initial conditions or settings",
        "derived by named formulas or assumed, each value with its source in the pair file",
        "decides every response: no curve of the source can be copied",
    ),
)

MEASURED: dict[tuple[int, bool], Measurement] = {
    (0, False): Measurement(
        0.75735,
        (
            ("fold", 0.9836052),
            ("fold", 1.0849132),
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (0, True): Measurement(
        0.32511,
        (
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (1, False): Measurement(
        0.72739,
        (
            ("fold", 0.997244),
            ("period-doubling", 0.9988069),
            ("fold", 1.0855394),
            ("period-doubling", 1.0855792),
            ("period-doubling", 2.2498352),
            ("period-doubling", 2.2694213),
        ),
    ),
    (1, True): Measurement(
        0.3145,
        (
            ("period-doubling", 2.2498352),
            ("period-doubling", 2.2694213),
        ),
    ),
    (2, False): Measurement(
        0.75735,
        (
            ("fold", 0.9836052),
            ("fold", 1.0849132),
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (2, True): Measurement(
        0.35163,
        (
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (3, False): Measurement(
        0.75735,
        (
            ("fold", 0.9836052),
            ("fold", 1.0849132),
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (3, True): Measurement(
        0.50973,
        (
            ("fold", 1.0645759),
            ("fold", 1.0920686),
            ("period-doubling", 2.2447156),
            ("period-doubling", 2.2809052),
        ),
    ),
    (12, False): Measurement(
        0.77534,
        (
            ("fold", 0.9777421),
            ("fold", 1.0845522),
            ("period-doubling", 2.240428),
            ("period-doubling", 2.2852784),
        ),
    ),
    (12, True): Measurement(
        0.33502,
        (
            ("period-doubling", 2.240428),
            ("period-doubling", 2.2852784),
        ),
    ),
}
"""By row (0: none, the consistent reading) and whether an error e is added."""
