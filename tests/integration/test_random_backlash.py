"""Random backlash oscillators: the same special points by harmonic balance, by exact integration, and traced back."""

from __future__ import annotations

import casadi as ca
import pytest
import reference_systems as rs
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from continuation import Branch, HarmonicBalance, Shooting, System, trace


def oscillator(damping: float, fluctuation: float, load: float, force: float, phase: float) -> System:
    """x'' + 2 damping x' + (1 + fluctuation cos(theta)) f(x) = load + force cos(theta + phase)."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x)
    drive = load + force * ca.cos(theta + phase) - 2 * damping * v
    return System(
        name="random backlash",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": drive - (1 + fluctuation * ca.cos(theta)) * mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[mesh],
    )


def points(branch: Branch) -> list[tuple[str, float]]:
    return [(q.kind, q.parameter) for q in branch.special_points]


@settings(max_examples=2, deadline=None)
@given(
    damping=st.floats(0.02, 0.08),
    fluctuation=st.floats(0.0, 0.4),
    load=st.floats(0.05, 0.6),
    force=st.floats(0.0, 0.3),
    phase=st.floats(0.0, 6.28),
    start=st.floats(0.9, 2.2),
    width=st.floats(0.08, 0.2),
)
@example(damping=0.034, fluctuation=0.336, load=0.265, force=0.292, phase=3.752, start=1.679, width=0.332)
def test_the_same_points_by_every_way(damping, fluctuation, load, force, phase, start, width):
    assume(fluctuation + force > 0.02)
    system, span = oscillator(damping, fluctuation, load, force, phase), (start, start - width)
    problem, other = HarmonicBalance().discretise(system, "omega"), Shooting().discretise(system, "omega")
    first = problem.guess(omega=start)
    branch = trace(problem, first, span)
    assert branch.stop == f"reached omega = {span[1]:.6g}"
    found = points(branch)
    for again in (
        points(trace(other, other.guess(omega=start), span)),
        points(trace(problem, branch.orbits[-1], span[::-1]))[::-1],
    ):
        assert [kind for kind, _ in again] == [kind for kind, _ in found]
        assert [p for _, p in again] == pytest.approx([p for _, p in found], abs=1e-7)
    assert branch.unresolved == ()
    assert all(q.error < 1e-8 for q in branch.special_points)
