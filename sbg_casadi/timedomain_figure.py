"""Figures of the commands ``sweep``, ``section`` and ``basins``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from continuation import Basins, Branch, Sweep, Waterfall
from continuation.plotting import plot_branch, plot_sweep
from continuation.plotting_timedomain import plot_basins, plot_bifurcation, plot_waterfall
from sbg_casadi.documents import STATE

Document = Mapping[str, Any]

COLOURS = ("black", "#d95f02")
"""Sweep up and sweep down."""


def sweep_figure(document: Document, sweeps: Sequence[Sweep], branch: Branch | None) -> Figure:
    """Draw the bifurcation diagram above the RMS, up and down, with the traced response where there is one."""
    figure = _figure(9.0, 8.0)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for sweep, colour in zip(reversed(sweeps), reversed(COLOURS), strict=True):
        plot_bifurcation(sweep, STATE, ax=upper, colour=colour)
        name = "up" if colour == COLOURS[0] else "down"
        plot_sweep(sweep, ax=lower, colour=colour, label=f"sweep {name}")
    if branch is not None:
        plot_branch(branch, STATE, ax=lower, colour="grey", label="traced response")
    upper.set(xlabel="", ylabel="lambda at phase 0 / half backlash")
    lower.set(xlabel="frequency ratio omega_m / omega_n", ylabel="RMS of lambda about its mean / half backlash")
    lower.legend(loc="best", fontsize="small")
    rpm = document["unit_ratio_rpm"]
    if rpm is not None:
        above = upper.secondary_xaxis("top", functions=(lambda v: v * rpm, lambda v: v / rpm))
        above.set_xlabel("pinion speed / rpm")
    figure.suptitle(f"{document['pair']}, {document['state']}: sweeps up and down")
    return figure


def waterfall_figure(document: Document, found: Sequence[Waterfall]) -> Figure:
    """Draw the spectra over frequency ratio and order, sweep up beside sweep down."""
    figure = _figure(12.0, 6.0)
    axes = figure.subplots(1, 2, sharey=True)
    rpm = document["unit_ratio_rpm"]
    for ax, table, name in zip(axes, found, ("up", "down"), strict=True):
        ax.set_title(f"sweep {name}", pad=24 if rpm is not None else None)
        if np.any(table.amplitudes > 0):
            plot_waterfall(table, ax=ax)
        ax.set(xlabel="frequency ratio omega_m / omega_n", ylabel="order of the mesh frequency")
        if rpm is not None:
            above = ax.secondary_xaxis("top", functions=(lambda v: v * rpm, lambda v: v / rpm))
            above.set_xlabel("pinion speed / rpm")
    figure.suptitle(f"{document['pair']}, {document['state']}: spectra of lambda along the sweeps")
    return figure


def plot_points(document: Document, *, ax: Axes) -> Axes:
    """Draw the stroboscopic points and those at the onset of drive contact in the phase plane."""
    for key, mark, label in (("strobe", ".", "phase 0"), ("onset", "x", "onset of contact")):
        table = np.array(document[key]).reshape(-1, 2)
        if len(table):
            ax.plot(table[:, 0], table[:, 1], mark, color="black" if key == "strobe" else "#d95f02", markersize=3,
                    linestyle="none", label=label, gid=key)  # fmt: skip
    ax.set(xlabel="lambda / half backlash", ylabel="its rate in tau = omega_n t", title="Poincare points")
    ax.legend(loc="best", fontsize="small")
    return ax


def plot_portrait(document: Document, *, ax: Axes) -> Axes:
    """Draw the trajectory in the phase plane."""
    table = np.array(document["portrait"])
    ax.plot(table[:, 0], table[:, 1], color="black", linewidth=0.5, gid="portrait")
    ax.set(xlabel="lambda / half backlash", ylabel="its rate in tau = omega_n t", title="phase portrait")
    return ax


def plot_orders(document: Document, *, ax: Axes) -> Axes:
    """Draw the amplitude spectrum of lambda over orders of the mesh frequency, logarithmic."""
    spectrum = document["spectrum"]
    ax.semilogy(
        spectrum["orders"], np.maximum(spectrum["amplitudes"], 1e-12), color="black", linewidth=0.7, gid="spectrum"
    )
    top = max(spectrum["amplitudes"])
    ax.set(ylim=(1e-7 * top, 3 * top), xlabel="order of the mesh frequency", title="spectrum of lambda")
    ax.set_ylabel("amplitude / half backlash")
    return ax


def plot_exponents(document: Document, *, ax: Axes) -> Axes:
    """Draw the Lyapunov exponents per unit of tau with three standard errors; beside the largest, from lambda alone."""
    rows = document["exponents"]
    number = np.arange(1, len(rows) + 1)
    values, errors = ([r[k] for r in rows] for k in ("per_tau", "error"))
    _bars(ax, number, values, errors, "o", "black", "from the model")
    for k, (row, mark) in enumerate(zip(document["series_exponents"]["rows"], "s^", strict=False), 1):
        _bars(ax, [1 + 0.25 * k], [row["per_tau"]], [row["error"]], mark, COLOURS[1], f"lambda alone, {row['method']}")
    if document["series_exponents"]["rows"]:
        ax.legend(loc="best", fontsize="small")
    ax.axhline(0.0, color="0.6", linewidth=0.8)
    ax.set(xlabel="number", ylabel="exponent per unit of tau, 3 errors", title="Lyapunov exponents")
    return ax


def _bars(
    ax: Axes, at: Any, values: Sequence[float], errors: Sequence[float], mark: str, colour: str, label: str
) -> None:
    ax.errorbar(at, values, yerr=3 * np.array(errors), fmt=mark, color=colour, markersize=4, capsize=3, label=label)


def section_figure(document: Document) -> Figure:
    """Return Poincare points, phase portrait, spectrum and exponents in one figure."""
    figure = _figure(11.0, 8.5)
    axes = figure.subplots(2, 2).ravel()
    for plot, ax in zip((plot_points, plot_portrait, plot_orders, plot_exponents), axes, strict=True):
        plot(document, ax=ax)
    at = document["frequency_ratio"]
    figure.suptitle(f"{document['pair']}, {document['state']}: {document['verdict']} at frequency ratio {at:.10g}")
    return figure


def basins_figure(document: Document, basins: Basins) -> Figure:
    """Return the picture of the basins."""
    figure = _figure(7.0, 7.0)
    plot_basins(basins, ax=figure.subplots())
    at = document["frequency_ratio"]
    figure.suptitle(f"{document['pair']}, {document['state']}: basins at frequency ratio {at:.10g}")
    return figure


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a file."""
    figure.savefig(path, dpi=150)
