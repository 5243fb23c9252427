"""Grazing points and curves: found, counted and located against closed forms and between methods."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, HarmonicBalance, Shooting, System, trace, track
from continuation.branches.grazing import search
from continuation.branches.newton import Metric, correct

ZETA, STIFF = 0.05, 5.0


# ------------------------------------------------------------------------------------------------ made-up waveforms
class Plain(SimpleNamespace):
    """Stands in for a System, which is its own key."""

    __hash__, __eq__ = object.__hash__, object.__eq__


class Strip:
    """The branch u = sin(3 p), along which the argument of one contact has a given half spectrum."""

    parameter = "p"

    def __init__(self, wave, level):
        contact = Contact(argument=ca.SX.sym("a"), breakpoints=(level,), slopes=(0.0, 1.0))
        self.system = Plain(contacts=(contact,), autonomous=False)
        self.ports = SimpleNamespace(outputs=1)
        self.forces = SimpleNamespace(argument=lambda i, Y, p: np.array(wave(p), dtype=complex))

    def linearise(self, u, p):
        return u - np.sin(3 * p), np.eye(1), np.array([-3 * np.cos(3 * p)])

    def lengthen(self, u, like):
        return u

    def vector(self, p):
        return p


def found(wave, level, step):
    problem, metric = Strip(wave, level), Metric(1.0, 1.0)
    grid = np.linspace(0, 1, round(1 / step) + 1)
    nodes = [correct(problem, (np.sin([3 * p]), p), (np.zeros(1), 1.0), metric) for p in grid]
    touches, notes = search(problem, nodes, metric)
    assert notes == []
    return sorted(touches, key=lambda t: (t.segment.a.p, t.x))


def check(touches, wanted):
    """Compare with (root, side, change) in order."""
    assert [(t.side, t.change) for t in touches] == [w[1:] for w in wanted]
    for t, (root, _, _) in zip(touches, wanted, strict=True):
        assert t.origin.a.p <= t.segment.a.p <= root <= t.segment.b.p <= t.origin.b.p


@pytest.mark.parametrize("step", [0.04, 0.2, 1.0])
@pytest.mark.parametrize("gap", [0.3, 1e-2, 1e-4])
def test_pair_inside_a_step(step, gap):
    """A maximum rises above the breakpoint and comes back; a phase that moves must not matter."""

    def wave(p):
        top = 1 - 0.7 * (p - 0.4321 - gap / 2) * (p - 0.4321 + gap / 2)
        return [0.1, (top - 0.1) / 2 * np.exp(2j * p)]

    check(found(wave, 1.0, step), [(0.4321 - gap / 2, 1, 2), (0.4321 + gap / 2, 1, -2)])


@pytest.mark.parametrize("step", [0.04, 0.2, 1.0])
@pytest.mark.parametrize("left", [0.1, 1e-4, 1e-6])
def test_near_miss_is_no_grazing(step, left):
    assert found(lambda p: [0.0, (1 - left - 0.7 * (p - 0.4321) ** 2) / 2 * np.exp(2j * p)], 1.0, step) == []


@pytest.mark.parametrize("step", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("level", [-0.5, -0.7, -0.74])
def test_extremum_that_is_born_first(step, level):
    """cos t + b cos 2t has a maximum -1 + b at pi from b = 1/4 on, and two minima -b - 1/(8 b)."""
    touches = found(lambda p: [0.0, 0.5, p / 2], level, step)
    b = 1 + level
    minima = np.sort(np.roots([8.0, 8 * level, 1.0]).real) if 64 * level**2 >= 32 else []  # b + 1/(8 b) = -level
    wanted = [(b, 1, 2)] + [(r, -1, d) for r in minima if r > 0.25 for d in (2, 2)]
    wanted = [w for w in wanted if 0 < w[0] < 1]
    assert len(touches) >= 1
    maxima = [t for t in touches if t.side == 1]
    check(maxima, [(b, 1, 2)])
    assert len([t for t in touches if t.side == -1]) == len(wanted) - 1


def test_mean_that_drifts_through_both_sides():
    """cos t + 3 p - 1.5 touches 0 with its maximum at p = 1/6 and with its minimum at p = 5/6."""
    for step in (0.05, 0.5, 1.0):
        check(found(lambda p: [3 * p - 1.5, 0.5], 0.0, step), [(1 / 6, 1, 2), (5 / 6, -1, -2)])


# ------------------------------------------------------------------------------------------------ closed forms
def stop(argument=lambda x: x, level=1.0, name="stop"):
    """x'' + 2 zeta x' + x + 5 max(x - 1, 0) = f cos(theta)."""
    x, v, theta, omega, f, zeta = rs.symbols("x", "v", "theta", "omega", "f", "zeta")
    contact = Contact(argument=argument(x), breakpoints=(level,), slopes=(0.0, STIFF), name=name)
    return System(
        name="stop",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": f * ca.cos(theta) - 2 * zeta * v - x - contact.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5), "f": (f, 0.2), "zeta": (zeta, ZETA)},
        contacts=[contact],
    )


def touching(f):
    """Frequencies at which the linear oscillation has the amplitude 1."""
    return np.sqrt(np.sort(np.roots([1, 4 * ZETA**2 - 2, 1 - f**2]).real))


LEAST = 2 * ZETA * np.sqrt(1 - ZETA**2)  # force whose peak just touches


def grazing(branch):
    return [q for q in branch.special_points if q.kind == "grazing"]


@pytest.mark.parametrize(
    ("method", "step"),
    [(HarmonicBalance(), 0.02), (HarmonicBalance(), 0.2), (Shooting(), 0.2)],
    ids=["fine", "coarse", "shooting"],
)
@pytest.mark.parametrize("f", [LEAST * 1.02, LEAST * (1 + 1e-4), LEAST * (1 + 1e-6)])
def test_contact_at_the_peak_of_a_resonance(method, step, f):
    """Contact is made and lost within 2e-2, 1.4e-3 and 1.4e-4 of frequency; both points in closed form."""
    problem = method.discretise(stop(), "omega", f=f)
    branch = trace(problem, problem.guess(omega=0.8), (0.8, 1.2), step=step, max_step=step)
    points = grazing(branch)
    assert [q.parameter for q in points] == pytest.approx(touching(f), abs=1e-8)
    assert [q.note.split(": ")[1] for q in points] == ["2 contact changes gained", "2 contact changes lost"]
    for q, w in zip(points, touching(f), strict=True):
        phase = np.angle(1 - w**2 + 2j * ZETA * w)
        assert q.note.startswith(f"maximum of stop at 1, phase {phase:.4g}"[:-1])
        assert q.error < 1e-8
        assert abs(q.parameter - w) <= q.error + 1e-10
        assert q.status == "located"
    assert branch.unresolved == ()


@pytest.mark.parametrize("step", [0.02, 0.2])
@pytest.mark.parametrize("f", [LEAST * (1 - 1e-6), LEAST * 0.99])
def test_no_contact_below_the_peak(step, f):
    problem = HarmonicBalance().discretise(stop(), "omega", f=f)
    branch = trace(problem, problem.guess(omega=0.8), (0.8, 1.2), step=step, max_step=step)
    assert branch.special_points == ()
    assert branch.unresolved == ()


def test_an_argument_that_is_not_linear_and_one_that_is_symmetric():
    """x^2 touches 1 with its two maxima at once: two points at one frequency."""
    problem = HarmonicBalance().discretise(stop(argument=lambda x: x * x, name="square"), "omega")
    branch = trace(problem, problem.guess(omega=0.85), (0.85, 0.91), max_step=0.02)
    first, second = grazing(branch)
    low = touching(0.2)[0]
    assert [first.parameter, second.parameter] == pytest.approx([low, low], abs=1e-9)
    assert first.note != second.note
    shifts = sorted(float(q.note.split("phase ")[1].split(":")[0]) for q in (first, second))
    assert shifts[1] - shifts[0] == pytest.approx(np.pi, abs=1e-5)


def test_autonomous_cycle():
    """The van der Pol cycle grows with nothing but the gap of a stop: its amplitude is known without the stop."""
    x, v, gain, mu = rs.symbols("x", "v", "gain", "mu")
    contact = Contact(argument=gain * x, breakpoints=(2.0,), slopes=(0.0, 1.0), name="stop")
    system = System(
        name="van der Pol with a stop",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": mu * (1 - x**2) * v - x - contact.force},
        parameters={"gain": (gain, 0.9), "mu": (mu, 0.5)},
        contacts=[contact],
    )
    problem = HarmonicBalance(max_harmonics=63).discretise(system, "gain")
    branch = trace(problem, problem.guess(gain=0.98), (0.98, 1.0), max_step=0.01)
    (point,) = grazing(branch)
    amplitude = rs_amplitude(0.5)
    assert point.parameter == pytest.approx(2.0 / amplitude, abs=1e-8)
    curve = track(point, parameters=("gain", "mu"), span={"mu": (0.45, 0.55)}, max_step=0.05)
    for gain_, mu_ in curve.values[[0, -1]]:
        assert gain_ == pytest.approx(2.0 / rs_amplitude(mu_), abs=1e-8)


def rs_amplitude(mu):
    """Largest x of the van der Pol cycle, by SciPy."""
    from scipy.integrate import solve_ivp

    def top(t, z):
        return z[1]

    top.direction = -1
    run = solve_ivp(
        lambda t, z: [z[1], mu * (1 - z[0] ** 2) * z[1] - z[0]], (0, 120), [2.0, 0.0],
        method="DOP853", rtol=1e-12, atol=1e-13, events=top,
    )  # fmt: skip
    return float(run.y_events[0][-1][0])


# ------------------------------------------------------------------------------------------------ curves
@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting()], ids=lambda m: type(m).__name__)
def test_grazing_curve_in_closed_form(method):
    """f = |1 - w^2 + 2 i zeta w| all along, with its extremum at the peak of the resonance."""
    problem = method.discretise(stop(), "omega")
    branch = trace(problem, problem.guess(omega=0.85), (0.85, 0.95), max_step=0.05)
    (point,) = grazing(branch)
    curve = track(point, parameters=("omega", "f"), span={"f": (0.05, 0.3)}, max_step=0.05)
    w, f = curve.values.T
    assert f == pytest.approx(np.hypot(1 - w**2, 2 * ZETA * w), abs=1e-9)
    assert (w.min(), w.max()) == pytest.approx(touching(0.3), abs=1e-9)  # both flanks, through the turning point
    (least,) = curve.points
    assert least.kind == "extremum"
    assert least.parameters == pytest.approx((np.sqrt(1 - 2 * ZETA**2), LEAST), abs=1e-8)
    across = track(point, parameters=("omega", "zeta"), span={"zeta": (0.03, 0.08)}, max_step=0.01)
    w, zeta = across.values.T
    assert np.hypot(1 - w**2, 2 * zeta * w) == pytest.approx(0.2, abs=1e-9)


def test_grazing_curve_of_the_gear_passes_through_located_points():
    """With contact loss elsewhere on the orbit, in a parameter of the load."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    branch = trace(problem, problem.guess(frequency_ratio=1.7), (1.7, 1.6))
    (point,) = grazing(branch)
    curve = track(point, parameters=("frequency_ratio", "torque"), span={"torque": (0.13, 0.15)}, max_step=0.01)
    for torque in (0.13, 0.15):
        other = problem.method.discretise(rs.gear(), "frequency_ratio", torque=torque)
        alone = grazing(trace(other, other.guess(frequency_ratio=1.75), (1.75, 1.5)))[0].parameter
        i = int(np.argmin(np.abs(curve.values[:, 1] - torque)))
        assert curve.values[i, 1] == pytest.approx(torque, abs=1e-12)
        assert curve.values[i, 0] == pytest.approx(alone, abs=1e-8)


# ------------------------------------------------------------------------------------------------ what must not matter
GEAR = (1.611568474, 1.520103327, 0.787985453, 0.603791859)  # in order along the branch


@pytest.mark.parametrize(
    ("span", "wanted", "step"),
    [((1.7, 1.4), GEAR[:2], 0.03), ((1.7, 1.4), GEAR[:2], 0.1), ((0.85, 0.5), GEAR[2:], 0.1)],
)
def test_gear_points_do_not_depend_on_step_and_direction(span, wanted, step):
    """Between them every orbit has the contact changes that they say."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    forth = trace(problem, problem.guess(frequency_ratio=span[0]), span, step=step, max_step=step)
    assert [q.parameter for q in grazing(forth)] == pytest.approx(wanted, abs=1e-8)
    back = trace(problem, forth.orbits[-1], span[::-1], step=step, max_step=step)
    assert [q.parameter for q in grazing(back)] == pytest.approx(wanted[::-1], abs=1e-8)
    for branch in (forth, back):
        counts = [len(o.contacts["mesh"][0]) for o in branch.orbits]
        changes = np.zeros(len(counts), dtype=int)
        for q in grazing(branch):
            changes[q.index + 1] += 2 if q.note.endswith("gained") else -2
        assert np.cumsum(changes) + counts[0] == pytest.approx(counts)
        assert branch.unresolved == ()


def test_harmonic_balance_and_shooting_agree_on_the_backlash_oscillator():
    found = []
    for method in (HarmonicBalance(), Shooting()):
        problem = method.discretise(rs.parametric_backlash(), "omega")
        branch = trace(problem, problem.guess(omega=1.0), (1.0, 0.69), max_step=0.05)
        found.append([q.parameter for q in grazing(branch)])
    assert len(found[0]) == 1
    assert found[1] == pytest.approx(found[0], abs=1e-8)


@pytest.mark.parametrize(("start", "end", "wanted"), [(0.80, 0.825, 0.8206310877), (1.42, 1.40, 1.4070884660)])
def test_limits_of_contact_loss_of_the_backlash_oscillator(start, end, wanted):
    """As published for its branch of small amplitude: no contact loss outside of them."""
    problem = HarmonicBalance().discretise(rs.backlash(), "omega")
    branch = trace(problem, problem.guess(omega=start), (start, end))
    (point,) = grazing(branch)
    assert point.parameter == pytest.approx(wanted, abs=1e-9)
    assert "gained" in point.note


def test_two_contacts_and_an_argument_that_moves_with_the_phase():
    """A mesh with a transmission error, a stop behind it: every change of the contact pattern is one of the points."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    gap = x - 0.15 * ca.cos(theta) - 0.21 * ca.sin(2 * theta)
    mesh = Contact(argument=gap, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0), name="mesh")
    limit = Contact(argument=x, breakpoints=(2.0,), slopes=(0.0, 0.8), name="stop")
    drive = 0.43 + 0.07 * ca.cos(theta) - 0.15 * v
    system = System(
        name="mesh and stop",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": drive - (1 + 0.18 * ca.cos(theta)) * mesh.force - limit.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[mesh, limit],
    )
    problem, found = HarmonicBalance().discretise(system, "omega"), []
    for step in (0.004, 0.15):
        branch = trace(problem, problem.guess(omega=0.63), (0.63, 0.47), step=step, max_step=step)
        assert branch.unresolved == ()
        for name in ("mesh", "stop"):
            counts = np.array([len(o.contacts[name][0]) for o in branch.orbits])
            changes = np.zeros(len(counts), dtype=int)
            for q in grazing(branch):
                if f" of {name} " in q.note:
                    changes[q.index + 1] += 2 if "gained" in q.note else -2
            assert (np.cumsum(changes) + counts[0]).tolist() == counts.tolist()
        found.append(branch.special_points)
    assert sorted({q.kind for q in found[0]}) == ["grazing", "period-doubling"]
    assert len(found[0]) >= 4
    assert [q.kind for q in found[1]] == [q.kind for q in found[0]]
    assert [q.parameter for q in found[1]] == pytest.approx([q.parameter for q in found[0]], abs=1e-8)
