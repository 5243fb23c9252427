"""Figures of studies in the time domain; every plot function has a pure one beside it that returns the arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from continuation.plotting import SWEEP_MARKER, new_axes, sweep_direction

if TYPE_CHECKING:
    from continuation.timedomain.basins_result import Basins
    from continuation.timedomain.sweep_result import Sweep
    from continuation.timedomain.waterfall import Waterfall

SHADES = ("#f7f7f7", "#636363", "#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e", "#e6ab02")
"""Colours of basins, in the order of their shares; the first four differ in grey."""

NOWHERE = "#000000"


def bifurcation_points(sweep: Sweep, state: str) -> tuple[np.ndarray, np.ndarray]:
    """Return parameter and a state (N,) at all Poincare points of a sweep.

    Raises
    ------
    ValueError
        If there is no such state.
    """
    if state not in sweep.state_names:
        raise ValueError(f"bifurcation diagram: no state {state!r}; known: {', '.join(sweep.state_names)}")
    table = sweep.points[:, :, sweep.state_names.index(state)]
    values = np.repeat(sweep.values, table.shape[1])
    there = np.isfinite(table.ravel())
    return values[there], table.ravel()[there]


def plot_bifurcation(sweep: Sweep, state: str, *, ax: Axes | None = None, colour: str = "black") -> Axes:
    """Draw a state at phase 0 of every excitation period over the swept parameter; small dots, circles for down."""
    ax = new_axes() if ax is None else ax
    x, y = bifurcation_points(sweep, state)
    direction = sweep_direction(sweep)
    marker, fill = SWEEP_MARKER[direction]
    (line,) = ax.plot(x, y, color=colour, gid=f"points {direction}")
    size = 1.5 if direction == "up" else 3.0
    line.set(linestyle="none", marker=marker, markersize=size, markeredgewidth=0.4, fillstyle=fill)
    ax.set_xlabel(sweep.parameter)
    ax.set_ylabel(f"{state} at phase 0")
    return ax


def plot_basins(basins: Basins, *, ax: Axes | None = None) -> Axes:
    """Draw the basins of a grid or sample of two coordinates; black: not recognised or lost.

    Raises
    ------
    ValueError
        If there are not two coordinates.
    """
    if len(basins.axes) != 2:
        raise ValueError(f"picture of basins: expected two coordinates, got {len(basins.axes)}")
    ax = new_axes(6.5, 6.0) if ax is None else ax
    (across, (left, right)), (up, (low, high)) = basins.axes.items()
    count = len(basins.attractors)
    colours = [NOWHERE, *(SHADES[k % len(SHADES)] for k in range(count))]
    shown = np.maximum(basins.labels, -1) + 1
    table, top = ListedColormap(colours), count + 0.5
    if basins.counts is not None:
        picture = shown.reshape(basins.counts).T
        ax.imshow(
            picture, extent=(left, right, low, high), origin="lower", aspect="auto", cmap=table, vmin=-0.5, vmax=top
        )
    else:
        ax.scatter(basins.points[:, 0], basins.points[:, 1], c=shown, s=4, cmap=table, vmin=-0.5, vmax=top)
    for k, attractor in enumerate(basins.attractors):
        columns = [basins.state_names.index(name) for name in (across, up)]
        (mark,) = ax.plot(*attractor.points[:, columns].T, linestyle="none", gid=f"attractor {k + 1}")
        mark.set(marker="o", markersize=6, markerfacecolor=SHADES[k % len(SHADES)], markeredgecolor="black")
        mark.set_label(f"{k + 1}: {attractor.verdict}, {basins.fractions[k]:.3f} +- {basins.fraction_errors[k]:.1g}")
    ax.set(xlim=(left, right), ylim=(low, high), xlabel=f"{across} at phase 0", ylabel=f"{up} at phase 0")
    if count:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize="small")
    return ax


def plot_waterfall(waterfall: Waterfall, *, ax: Axes | None = None) -> Axes:
    """Draw amplitudes in decibels below the largest over parameter and order, light for large ones.

    Raises
    ------
    ValueError
        If there is no spectrum at all.
    """
    if not np.any(waterfall.amplitudes > 0):
        raise ValueError(f"waterfall of {waterfall.quantity!r}: expected at least one spectrum that is not 0")
    ax = new_axes() if ax is None else ax
    order = np.argsort(waterfall.values, kind="stable")
    largest = np.nanmax(waterfall.amplitudes)
    level = 20 * np.log10(np.maximum(waterfall.amplitudes[order], 1e-5 * largest) / largest)
    mesh = ax.pcolormesh(
        waterfall.values[order], waterfall.orders, level.T, shading="nearest", cmap="gray", gid="waterfall"
    )
    ax.figure.colorbar(mesh, ax=ax, label=f"amplitude of {waterfall.quantity} / dB below the largest")
    ax.set_xlabel(waterfall.parameter)
    ax.set_ylabel("order of the excitation frequency")
    return ax
