"""Rows for the paper's equations: what follows from them by arithmetic, whatever numbers the symbols stand for."""

from __future__ import annotations

import math
from itertools import pairwise

from sbg_casadi.derived import direction_cosines, pitch_cone_angle
from sbg_casadi.equations import EIGHT, transmission_error
from sbg_casadi.paper.printed import (
    CASES,
    EQUATIONS,
    ERROR_COEFFICIENTS,
    FORCES,
    HARMONICS,
    PAIRS,
    STIFFNESS_COEFFICIENTS,
)
from sbg_casadi.paper.row import Row, compared, number, stated, unchecked

_ROUNDING = 1e-12

# Numbers for the symbols; any others show the same, since the relations are linear in each of them.
_COSINES, _RADII = {"a1": 0.31, "a2": 0.53, "a3": 0.77}, (0.031, 0.083)
_MASS, _INERTIA, _TORQUE = (1.3, 3.9), (1.1e-3, 2.4e-2), 170.0
_K0, _B, _CM, _FORCE = 4.1e8, 7.5e-5, 2.3e3, 900.0


def equation_rows() -> list[Row]:
    """Return the rows of equations (1)-(29), in that order.

    Examples
    --------
    >>> [r.verdict for r in equation_rows() if r.place == "(25)"]
    ['contradicted']
    """
    return [
        *_coordinates(),
        *_forces(),
        *(_cosines(case) for case in CASES),
        _radius(),
        _mesh_damping(),
        _error_series(),
        *_harmonics(),
        _mesh_frequency(),
        *_scaling(),
        _relative(),
        *_motion(),
        _natural(),
        _unit(),
    ]


def _coordinates() -> list[Row]:
    left = len(EIGHT) - len(("phi_p", "theta_g")) + 1
    return [
        compared(
            "eight-coordinates", "Abstract; (1)-(8)", "equation", "the model has eight degrees of freedom", "8",
            float(len(EIGHT)), 0.0, agrees="six displacements and two rotations, one equation for each.",
            differs="the equations are for another number of coordinates.",
        ),
        compared(
            "seven-coordinates", "(23)-(29)", "equation", "number of equations after the rotations are replaced by "
            "lambda", "7", float(left), 0.0, agrees="lambda stands for both rotations, as the free rigid rotation "
            "allows.", differs="another number of equations is left.",
        ),
    ]  # fmt: skip


def _gradient(name: str) -> float:
    """Return d(lambda)/dq of (14), which is linear, for the numbers above."""
    q = dict.fromkeys(EIGHT, 0.0) | {name: 1.0}
    return float(transmission_error(q, tuple(_COSINES.values()), *_RADII))


def _forces() -> list[Row]:
    values = _COSINES | {"r_p a3": _RADII[0] * _COSINES["a3"], "r_g a3": _RADII[1] * _COSINES["a3"]}
    rows = []
    for name, (n, sign, factor) in FORCES.items():
        ours = -_gradient(name) / values[factor]  # force over F_n and the printed factor
        off = sign - ours
        rows.append(
            stated(
                f"force-{n}", f"({n})", "equation", f"mesh force on {name} is the virtual work of lambda of (14)",
                _signed(sign, factor), _signed(ours, factor),
                abs(off) <= _ROUNDING, difference=off, tolerance=_ROUNDING,
                agrees="the printed right-hand side is -F_n d(lambda)/dq.",
                differs="the printed right-hand side does no work that fits lambda.",
            )
        )  # fmt: skip
    return rows


def _signed(value: float, factor: str) -> str:
    if abs(abs(value) - 1) > _ROUNDING:
        return f"{value:.6g} F_n {factor}"
    return f"{'+' if value > 0 else '-'}F_n {factor}"


def _cosines(case: str) -> Row:
    """The squares of (9)-(11) for pressure angle and teeth of a table; only the spiral angle is open."""
    table = PAIRS[case]
    alpha, delta = math.radians(float(table.pressure_angle)), pitch_cone_angle(*table.teeth)

    def off(beta: float) -> float:
        return sum(a**2 for a in direction_cosines(alpha, math.radians(beta), delta, 1, printed=True)) - 1

    angles = [0.5 * i for i in range(91)]
    worst = max(angles, key=lambda beta: abs(off(beta)))
    chance = [a for a, b in pairwise(angles[1:]) if off(a) * off(b) <= 0]
    also = f" and, by chance, near {chance[0]:.0f} deg" if chance else ""
    return stated(
        f"cosines-{case}", "(9)-(11)", "equation",
        f"a1, a2, a3 are direction cosines: their squares sum to 1 at any spiral angle ({case})", "1",
        f"{1 + off(35.0):.3f} at a spiral angle of 35 deg", abs(off(worst)) <= 1e-9, difference=round(off(35.0), 6),
        tolerance=1e-9, agrees="they do.",
        differs=f"they do at 0 deg{also} only; with cos(alpha) in the second term of (9) and a minus in (10) they do "
        "at any.",
    )  # fmt: skip


def _radius() -> Row:
    twice = 1 / math.cos(math.radians(20.0))
    return compared(
        "radius-and-a3", "(7), (8), (11); List of symbols", "equation",
        "the radius that multiplies a3 is a base radius (torque over F_n r a3)", "1", twice, 1e-3,
        agrees="torque and normal force balance.",
        differs="a3 holds cos(alpha) already, so a base radius counts it twice and F_n comes out 6.4 % too large; the "
        "mean pitch radius balances.",
    )  # fmt: skip


def _mesh_damping() -> Row:
    return unchecked(
        "damping-of-error", "(12), (15)", "equation",
        "damping acts on lambda', stiffness on lambda - e", "lambda'",
        "the two differ by e', and whether e is zero in the simulations is not printed.", "lambda' - e'",
    )  # fmt: skip


def _error_series() -> Row:
    """With one coefficient on cosine and sine every harmonic of (16) has its largest value at 45 degrees."""
    free = ERROR_COEFFICIENTS
    return stated(
        "error-series", "(16)", "equation", "e(t) is a Fourier series with one coefficient on cosine and sine",
        f"{free} coefficient per harmonic", f"{STIFFNESS_COEFFICIENTS} coefficients per harmonic",
        free == STIFFNESS_COEFFICIENTS, difference=float(STIFFNESS_COEFFICIENTS - free), tolerance=0.0,
        agrees="the series is general.",
        differs="(17) has two coefficients for each harmonic, as a series needs; with one, every harmonic is "
        "fixed to a phase of 45 deg and no measured e(t) fits.",
    )  # fmt: skip


def _harmonics() -> list[Row]:
    fewest, most = min(HARMONICS.values()), max(HARMONICS.values())
    return [
        stated(
            "harmonics", "(17), (21), section 4", "equation", "number of harmonics of the mesh stiffness",
            " and ".join(f"{n} in {place}" for place, n in HARMONICS.items()), f"{fewest} to {most} for one quantity",
            fewest == most, difference=float(most - fewest), tolerance=0.0, agrees="one number.",
            differs="the sum in (21) goes to seven, the text draws a fifth-order series, N_p is not printed.",
        ),
        stated(
            "initial-phase", "(16), text before (17)", "sentence", "e_0 is an initial phase shift", "phase shift",
            "constant term of (16)", _mean_of_error(0.25) == 0.0, difference=_mean_of_error(0.25), tolerance=0.0,
            agrees="it shifts the phase.", differs="in (16) e_0 stands alone: it is the mean of e, and moves no phase.",
        ),
    ]  # fmt: skip


def _mean_of_error(e_0: float) -> float:
    """Return the mean over a cycle of e of (16) with one harmonic."""
    count = 16
    angles = [2 * math.pi * i / count for i in range(count)]
    return round(sum(e_0 + 0.1 * math.cos(t) + 0.1 * math.sin(t) for t in angles) / count, 12)


def _mesh_frequency() -> Row:
    teeth, rpm = 14, 1200.0
    engagements = teeth * (rpm / 60)  # per second
    return compared(
        "mesh-frequency", "text before (17)", "equation", "omega_m = 2 pi / 60 N_1 gamma_s (14 teeth at 1200 rpm)",
        f"{2 * math.pi / 60 * teeth * rpm:.2f}", 2 * math.pi * engagements, 0.01, unit="rad/s",
        agrees="teeth in mesh per second times 2 pi.", differs="the mesh frequency is another.",
    )  # fmt: skip


def _scaling() -> list[Row]:
    (m_p, _), (i_p, i_g), (r_p, r_g) = _MASS, _INERTIA, _RADII
    m_eq = 1 / (r_p**2 / i_p + r_g**2 / i_g)
    omega_n = math.sqrt(_K0 / m_eq)
    return [
        compared(
            "mean-stiffness", "(18), (21)", "equation", "mean of K(t) in (21), from k_0 over m_eq omega_n^2", "1",
            _K0 / (m_eq * omega_n**2), _ROUNDING, agrees="by the definition of omega_n in (18).",
            differs="the scaling of (17) gives another mean.",
        ),
        compared(
            "bearing-damping", "(13), (24)", "equation", "bearing damping C/(m omega_n) over C of (13)", "2",
            (_CM / (m_p * omega_n)) / (_CM / (2 * m_p * omega_n)), _ROUNDING,
            agrees="(13) has 2 m omega_n below, (24)-(29) the factor 2.", differs="the factors do not fit.",
        ),
        compared(
            "dead-zone", "(15), (20)", "equation", "f of (20) at 1.7 half backlashes, from (15) over b", "0.7",
            (1.7 * _B - _B) / _B, _ROUNDING, agrees="(20) is (15) over b.", differs="(20) is not (15) over b.",
        ),
    ]  # fmt: skip


def _relative() -> Row:
    """Lambda'' of (14) from (7), (8) against the right-hand side of (23), with and without balanced torques."""
    (i_p, i_g), (r_p, r_g), a3 = _INERTIA, _RADII, _COSINES["a3"]
    m_eq = 1 / (r_p**2 / i_p + r_g**2 / i_g)

    def drive(gear_torque: float) -> float:
        pinion = (-r_p * _FORCE * a3 + _TORQUE) / i_p
        gear = (r_g * _FORCE * a3 - gear_torque) / i_g
        return a3 * (r_p * pinion - r_g * gear) * m_eq

    printed = _TORQUE / r_p * a3 - a3**2 * _FORCE
    off = drive(_TORQUE * r_g / r_p) / printed - 1
    other = drive(1.1 * _TORQUE * r_g / r_p) / printed - 1
    return stated(
        "relative-equation", "(23)", "equation", "T_m alone drives lambda", "a3 T_m", "a3 T_m", abs(off) <= 1e-12,
        difference=off, tolerance=1e-12,
        agrees=f"it follows from (7), (8), (14) and (18) when T_l / r_g = T_m / r_p, which is not printed; a gear "
        f"torque 10 % larger changes the right-hand side by {100 * other:+.1f} %.",
        differs="it does not follow from (7), (8) and (14).",
    )  # fmt: skip


def _motion() -> list[Row]:
    rows = []
    for name, (n, sign, cosine, factor) in EQUATIONS.items():
        _, force_sign, force_cosine = FORCES[name]
        wanted = _CM / _barred(name)
        holds = (sign, cosine) == (force_sign, force_cosine) and abs(factor - wanted) <= _ROUNDING * wanted
        rows.append(
            stated(
                f"motion-{n}", f"({n})", "equation", f"equation of {name} follows from ({FORCES[name][0]}) with (13) "
                "and (22): factor of the mesh damping", str(factor), number(wanted), holds,
                difference=wanted - factor, tolerance=1e-12, agrees="sign, cosine and factor are those that follow.",
                differs=f"({FORCES[name][0]}) and (22) give the factor {wanted:.0f}, as in the five other equations; "
                "with the printed one, the mesh damps this coordinate half as much as it pushes back on lambda.",
            )
        )  # fmt: skip
    return rows


def _barred(name: str) -> float:
    """Return C_p or C_g of (22) times m omega_n, what the damping C_m of a coordinate is measured in."""
    m_eq = 1 / (_RADII[0] ** 2 / _INERTIA[0] + _RADII[1] ** 2 / _INERTIA[1])
    omega_n, mass = math.sqrt(_K0 / m_eq), _MASS[name.endswith("g")]
    return _CM / (2 * mass * omega_n) * mass * omega_n


def _natural() -> Row:
    a3 = math.cos(math.radians(20.0))
    return compared(
        "natural-frequency", "(18), (23); section Numerical Results", "sentence",
        "omega_n is the natural frequency of the system with one degree of freedom (over omega_n)", "1", a3, 1e-3,
        agrees="it is.",
        differs="(23) has a3^2 K, so with rigid bearings it is a3 omega_n: at most cos(20 deg) = 0.94 of omega_n for "
        "the printed pressure angle, and 0.77 at a spiral angle of 35 deg.",
    )  # fmt: skip


def _unit() -> Row:
    """F_n = K f + C_m lambda' in N needs C_m in N s/m, and lambda is a length."""
    from sbg_casadi.units import registry

    unit = registry()
    wanted = unit("N").to_base_units().dimensionality
    found = (unit("N m s") * unit("m/s")).to_base_units().dimensionality
    return stated(
        "damping-unit", "(12); List of symbols", "equation", "C_m is given in N m s/rad", "N m s/rad", "N s/m",
        wanted == found, agrees="the terms of (12) have one unit.",
        differs="C_m lambda' of (12) is then in N m^2, lambda being a length, where F_n is in N; (12) needs N s/m.",
    )  # fmt: skip
