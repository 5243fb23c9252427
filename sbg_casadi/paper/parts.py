"""The computations for one case and state, each JSON-ready: response, sweeps, motions at the paper's frequencies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from continuation import (
    ContinuationError,
    FixedStep,
    Orbit,
    System,
    lyapunov_spectrum,
    series_exponent,
    simulate,
    sweep,
    up_and_down,
)
from continuation.timedomain.fixed_step import SuitableSteps
from sbg_casadi.documents import STATE, tree_document
from sbg_casadi.mesh import fourier_series
from sbg_casadi.model import gear_system, static_state
from sbg_casadi.outputs import dimensionless_outputs
from sbg_casadi.paper.plan import Plan, Subject, paper_frequencies
from sbg_casadi.paper.printed import State
from sbg_casadi.progress import Report
from sbg_casadi.response import PARAMETER, trace_tree
from sbg_casadi.sweep_study import LOAD, direction_document

Document = dict[str, Any]

_ORBITS = 48  # stable orbits at which forces are evaluated
_SAMPLES = 512
_LIMIT, _RECORDED = 1200, 600  # mesh periods for one motion to settle, and of its Poincare map
_AVERAGED = 800  # mesh periods of the variational exponent
_SERIES = 500  # mesh periods of the time series
_EACH, _EVERY = 64, 4  # samples of a mesh period, and which of them the time series takes
_DRAWN = 16  # mesh periods of a phase portrait


def stiffness_part(subject: Subject, state: State) -> Document:
    """Return the mesh stiffness over one cycle, over its mean, and the mean in N/m where the pair is physical."""
    d, derived = subject.pair.dimensionless(state), subject.pair.derived
    phase = np.linspace(0.0, 1.0, 201)
    value = 1 + fourier_series(d.stiffness_cosine, d.stiffness_sine, 2 * np.pi * phase)
    return {
        "phase": phase.tolist(),
        "value": value.tolist(),
        "peak_to_peak": float(np.ptp(value)),
        "mean": None if derived is None else derived.mesh_stiffness,
    }


def response_part(subject: Subject, state: State, plan: Plan, report: Report) -> Document:
    """Return the period-1 response with the branches of period 2 that leave it, and forces along it.

    Raises
    ------
    ContinuationError
        If no response can be traced.
    """
    d = subject.pair.dimensionless(state)
    tree = trace_tree(d, plan.span, 1, report=report)
    document = tree_document(tree, subject.pair, state, 0.0, plan.span)
    for branch in document["branches"]:
        for name in ("work", "provenance"):
            del branch[name]  # times and versions: a rerun gives the same text
    stable = [o for b in tree.branches for o in b.orbits if o.stability == "stable"]
    return document | {"forces": _forces(subject, state, stable)}


def _forces(subject: Subject, state: State, orbits: list[Orbit]) -> Document | None:
    """Return the largest dynamic factor and bearing force of some stable orbits, with their frequency ratios."""
    d, derived = subject.pair.dimensionless(state), subject.pair.derived
    rows = []
    for i in np.unique(np.linspace(0, len(orbits) - 1, _ORBITS).astype(int)) if orbits else ():
        out = dimensionless_outputs(orbits[i], d, samples=_SAMPLES)
        bearing = np.abs(out.bearing_force.values).max(axis=1)
        swing = np.ptp(out.bearing_force.values, axis=1)
        rows.append((orbits[i].value, float(out.dynamic_factor), float(bearing.max()), float(swing.max())))
    if not rows:
        return None
    table = np.array(rows)
    scale = 1.0 if derived is None else derived.mesh_stiffness * derived.half_backlash
    at = table.argmax(axis=0)
    return {
        "orbits": len(rows),
        "unit": "k_0 b" if derived is None else "N",
        "dynamic_factor": {"value": table[at[1], 1], "frequency_ratio": table[at[1], 0]},
        "bearing_force": {"value": table[at[2], 2] * scale, "frequency_ratio": table[at[2], 0]},
        "bearing_swing": {"value": table[at[3], 3] * scale, "frequency_ratio": table[at[3], 0]},
    }


def sweeps_part(subject: Subject, state: State, plan: Plan, folder: Path, report: Report) -> Document:
    """Return the sweeps up and down from the static state; ``folder`` keeps finished frequencies.

    Raises
    ------
    ContinuationError
        If the model is too stiff for explicit steps at every frequency.
    """
    d, case = subject.pair.dimensionless(state), subject.case
    sweeps = up_and_down(
        gear_system(d), PARAMETER, plan.frequencies(case, state), quantity=STATE, load=LOAD, start=static_state(d),
        recorded=100, resume=folder,
        progress=lambda done, total: report(done / total, f"{done} of {total} frequencies"),
    )  # fmt: skip
    rows, ends = [], {}
    for name, one in zip(("up", "down"), sweeps, strict=True):
        document = direction_document(one, name)
        for point in document["points"]:
            for key in ("harmonics", "evidence", "rotation", "rotation_error"):
                point.pop(key, None)
        rows.append(document)
        wanted = paper_frequencies(case, state)
        ends[name] = {str(f): one.states[i].tolist() for i, f in enumerate(one.values.tolist()) if f in wanted}
    return {"sweeps": rows, "states": ends}


def motions_part(subject: Subject, state: State, sweeps: Document, report: Report) -> Document:
    """Return the motions at the paper's frequencies, reached from rest and along both sweeps; equal ones once.

    Raises
    ------
    ContinuationError
        If one of them can't be integrated.
    """
    d = subject.pair.dimensionless(state)
    system, wanted = gear_system(d), paper_frequencies(subject.case, state)
    found = []
    for n, at in enumerate(wanted):
        report(n / len(wanted), f"motion at {at:g}")
        starts = {"at rest": static_state(d)}
        starts |= {f"sweep {k}": np.array(v[str(at)]) for k, v in sweeps["states"].items()}
        motions: list[Document] = []
        for name, x in starts.items():
            one = sweep(system, PARAMETER, [at], quantity=STATE, load=LOAD, start=x, limit=_LIMIT, recorded=_RECORDED)
            same = [m for m in motions if _alike(m, one.verdicts[0], float(one.rms[0]))]
            if same:
                same[0]["reached"].append(name)
            elif one.failures[0]:
                raise ContinuationError(one.failures[0])
            else:
                motions.append({"reached": [name]} | _motion(system, one, at))
        found.append({"frequency_ratio": at, "motions": motions})
    return {"frequencies": found}


def _alike(motion: Document, verdict: str, rms: float) -> bool:
    """Return whether a motion is one that is known; statistics of chaos scatter by some percent."""
    near = 1e-5 if verdict.startswith("period-") else 0.1
    return bool(motion["verdict"] == verdict and abs(motion["rms"] - rms) <= near * max(rms, 1e-3))


def _motion(system: System, one: Any, at: float) -> Document:
    """Return verdict, Poincare map, phase portrait and exponents of the motion that a sweep of one value ended in."""
    x, fixed = one.states[-1], FixedStep(SuitableSteps(system)(system.parameter_vector({PARAMETER: at})))
    columns = [system.state_names.index(n) for n in (STATE, f"d{STATE}")]
    period = int(one.period[0])
    strobe = one.points[0][np.isfinite(one.points[0]).all(axis=1)][:, columns]
    record = simulate(system, x, _SERIES, integrator=fixed, frequency_ratio=at)
    drawn = (period if 0 < period <= _DRAWN else _DRAWN) * _EACH + 1
    return {
        "verdict": one.verdicts[0],
        "period": period,
        "rms": float(one.rms[0]),
        "evidence": one.evidence[0],
        "strobe": strobe.tolist(),
        "portrait": record.states[:drawn, columns].tolist(),
        "variational": _variational(system, x, at, fixed),
        "series": _from_series(record.states[:-1:_EVERY, columns[0]], at),
    }


def _variational(system: System, x: np.ndarray, at: float, fixed: FixedStep) -> Document:
    """Return the largest exponent per unit of tau by the variational equations, with its standard error."""
    try:
        found = lyapunov_spectrum(
            system, x, periods=_AVERAGED, transient=0, count=1, integrator=fixed, frequency_ratio=at
        )
    except ContinuationError as error:
        return {"value": None, "error": None, "why": str(error)}
    return {"value": float(found.exponents[0]), "error": float(found.errors[0]), "why": ""}


def _from_series(series: np.ndarray, at: float) -> Document:
    """Return the same from lambda(t) alone by the method of Rosenstein: 5 delays of a quarter of a mesh period."""
    each = _EACH // _EVERY
    try:
        found = series_exponent(
            series, 2 * math.pi / (at * each), dimension=5, delay=each // 4, window=2 * each, horizon=8 * each
        )
    except ValueError as error:
        return {"value": None, "error": None, "why": str(error)}
    return {"value": found.value, "error": found.error, "why": ""}
