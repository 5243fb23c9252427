"""From a measured table to mesh stiffness and transmission error: k = F_n / (loaded - unloaded)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sbg_casadi.errors import PairError
from sbg_casadi.fourier import (
    PERIODIC,
    FourierSeries,
    Sampling,
    check_harmonics,
    check_periodic,
    fourier_fit,
    sampling,
)
from sbg_casadi.mesh import stiffness_fault, stiffness_minimum
from sbg_casadi.tables import Column, MeasuredTable

_LEAST = 1e-15  # m; a deflection this small is a zero with rounding errors


@dataclass(frozen=True, slots=True)
class MeshGeometry:
    """Hold what turns a measured table into forces and distances along the normal of the mesh.

    Attributes
    ----------
    teeth : (int, int)
        Pinion, gear.
    pinion_radius, gear_radius : float
        Mean pitch radii, m; they multiply a3 in equation (14).
    tangential_cosine : float
        a3 of equation (11).
    member : {"pinion", "gear"}
        Member that the torque is on.
    torque : float
        N m.

    Examples
    --------
    >>> mesh = MeshGeometry((14, 39), 0.027459, 0.0764935, 0.7697511, "pinion", 300.0)
    >>> round(mesh.normal_force(300.0))
    14193
    """

    teeth: tuple[int, int]
    pinion_radius: float
    gear_radius: float
    tangential_cosine: float
    member: Literal["pinion", "gear"]
    torque: float

    def normal_force(self, torque: float) -> float:
        """Return F_n in N at a torque in N m on ``member``."""
        radius = self.pinion_radius if self.member == "pinion" else self.gear_radius
        return torque / (radius * self.tangential_cosine)

    def along_normal(self, column: Column) -> np.ndarray:
        """Return a transmission error in m along the normal.

        An angle becomes an arc at the mean pitch radius of its member, an arc times a3 the distance along the normal,
        as in ``lambda = a3 (r_p phi_p - r_g theta_g)``, equation (14).
        """
        if column.member == "normal":
            return column.values
        radius = self.pinion_radius if column.member == "pinion" else self.gear_radius
        return column.values * self.tangential_cosine * (radius if column.angular else 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """Hold the mesh stiffness, and the unloaded transmission error if the table has it, of one table.

    Attributes
    ----------
    sampling : Sampling
        Mesh phases of the samples.
    samples : numpy.ndarray, shape (samples,)
        Mesh stiffness along the normal at the torque of the pair, N/m.
    stiffness : FourierSeries
        Of the samples, N/m.
    error : FourierSeries or None
        Unloaded transmission error along the normal, m; its mean has no effect on the motion.
    """

    sampling: Sampling
    samples: np.ndarray
    stiffness: FourierSeries
    error: FourierSeries | None

    def relative(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the stiffness harmonics over the mean of the table, as equation (21) has them."""
        mean = self.stiffness.mean
        return tuple(c / mean for c in self.stiffness.cosine), tuple(s / mean for s in self.stiffness.sine)


def stiffness_from_errors(normal_force: float, loaded: np.ndarray, unloaded: np.ndarray) -> np.ndarray:
    """Return k = F_n / (loaded - unloaded) in N/m from N and m along the normal.

    The unloaded error is no deflection: dividing by the loaded error alone would count it in k(t) and in e(t).

    Examples
    --------
    >>> stiffness_from_errors(14000.0, np.array([30e-6]), np.array([2e-6])).tolist()
    [500000000.0]
    """
    return normal_force / (loaded - unloaded)


def convert(table: MeasuredTable, mesh: MeshGeometry, harmonics: int, tolerance: float = PERIODIC) -> Conversion:
    """Return mesh stiffness and unloaded transmission error of a table as Fourier series.

    Parameters
    ----------
    table : MeasuredTable
    mesh : MeshGeometry
        Of the pair; between columns at several torques the stiffness is interpolated linearly at its torque.
    harmonics : int
        Number of harmonics, at most (samples in a mesh cycle - 1) / 2.
    tolerance : float
        Share of the peak-to-peak by which a mesh cycle may differ from the next.

    Raises
    ------
    PairError
        If columns are missing or contradict each other, the cycles are incomplete or don't repeat, the samples are
        too few, or the stiffness is not positive; with the line wherever there is one.
    """
    grid = sampling(table, mesh.teeth)
    check_harmonics(table, grid, harmonics)
    unloaded = _unloaded(table, mesh)
    samples = _at_torque(table, mesh, unloaded)
    check_periodic(table, grid, samples, "mesh stiffness", tolerance)
    error = None
    if unloaded is not None:
        check_periodic(table, grid, unloaded, "unloaded TE", tolerance)
        error = fourier_fit(table, grid, unloaded, harmonics)
    result = Conversion(grid, samples, fourier_fit(table, grid, samples, harmonics), error)
    cosine, sine = result.relative()
    if fault := stiffness_fault(cosine, sine):
        at = stiffness_minimum(cosine, sine)[1] / (2 * math.pi)
        away = np.abs((grid.phase - at + 0.5) % 1 - 0.5)
        raise PairError(
            f"{table.place}, line {table.lines[int(np.argmin(away))]}: truncation to {harmonics} harmonics {fault}; "
            "expected a mesh stiffness that stays positive, with more harmonics or a smoother table"
        )
    return result


def _unloaded(table: MeasuredTable, mesh: MeshGeometry) -> np.ndarray | None:
    columns = table.of("unloaded TE")
    if len(columns) > 1:
        raise PairError(f"{table.place} has {len(columns)} columns of unloaded TE; expected one")
    return mesh.along_normal(columns[0]) if columns else None


def _at_torque(table: MeasuredTable, mesh: MeshGeometry, unloaded: np.ndarray | None) -> np.ndarray:
    """Return the stiffness samples at the torque of the pair, from one column or between two."""
    loaded, given = table.of("loaded TE"), table.of("stiffness")
    if bool(loaded) == bool(given):
        have = "both loaded TE and stiffness" if loaded else "neither loaded TE nor stiffness"
        raise PairError(f"{table.place} has {have}; expected columns of one of them")
    if loaded and unloaded is None:
        raise PairError(
            f"{table.place} has no unloaded TE, without which it would count as deflection; expected a column such as "
            "unloaded TE gear [urad], of zeros if there is none"
        )
    columns = loaded or given
    if len(columns) == 1 and columns[0].torque is None:
        return _stiffness(table, columns[0], mesh, unloaded)
    torques = [column.torque for column in columns if column.torque is not None]
    if len(set(torques)) < len(columns):
        raise PairError(f"{table.place}: expected a different torque in the head of each {columns[0].quantity} column")
    pairs = sorted(zip(torques, columns, strict=True), key=lambda item: item[0])
    slack = 1e-9 * mesh.torque
    if not pairs[0][0] - slack <= mesh.torque <= pairs[-1][0] + slack:
        raise PairError(
            f"{table.place} holds the torques {', '.join(f'{torque:g}' for torque, _ in pairs)} N m; expected the "
            f"pair's {mesh.torque:g} N m on the {mesh.member} among or between them"
        )
    values = [_stiffness(table, column, mesh, unloaded) for _, column in pairs]
    upper = min(sum(torque < mesh.torque - slack for torque, _ in pairs), len(pairs) - 1)
    if abs(pairs[upper][0] - mesh.torque) <= slack:
        return values[upper]
    low, high = pairs[upper - 1][0], pairs[upper][0]
    share = (mesh.torque - low) / (high - low)
    return (1 - share) * values[upper - 1] + share * values[upper]


def _stiffness(table: MeasuredTable, column: Column, mesh: MeshGeometry, unloaded: np.ndarray | None) -> np.ndarray:
    """Return the stiffness of one column in N/m, positive at every sample."""
    if column.quantity == "stiffness":
        bad = np.flatnonzero(column.values <= 0)
        if bad.size:
            raise PairError(
                f"{table.place}, line {table.lines[bad[0]]}: stiffness is {column.values[bad[0]]:.4g} N/m; "
                "expected positive values"
            )
        return column.values
    assert unloaded is not None  # checked with the columns
    loaded = mesh.along_normal(column)
    bad = np.flatnonzero(loaded - unloaded <= _LEAST)
    if bad.size:
        depth = float(loaded[bad[0]] - unloaded[bad[0]])
        raise PairError(
            f"{table.place}, line {table.lines[bad[0]]}: loaded minus unloaded TE is {depth * 1e6:.4g} um along the "
            "normal; expected a positive deflection, errors count positive when the gear lags behind the pinion"
        )
    return stiffness_from_errors(
        mesh.normal_force(mesh.torque if column.torque is None else column.torque), loaded, unloaded
    )
