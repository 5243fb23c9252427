"""The error that harmonic balance claims, against the true one; rates of convergence, and the exact time domain."""

import casadi as ca
import general_contacts as general
import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, Contact, HarmonicBalance, NoConvergence, Shooting, System, trace
from continuation.branches.newton import Metric, correct, size_of
from continuation.orbits.contact_series import find_pattern
from continuation.orbits.spectrum import resize, unpack

FINE = 159  # harmonics of the orbit that counts as true: its own error is (63 / 159)^3 = 6 % of that at H = 63
THETA = np.linspace(0, 2 * np.pi, 4001)


def one_mass() -> System:
    """Backlash, forced and parametric, at any load and any place of the gap."""
    x, v, theta, omega, zeta, load, force, kappa = rs.symbols("x", "v", "theta", "omega", "z", "F", "a", "k")
    mesh = rs.dead_zone(x)
    push = (1 + kappa * ca.cos(theta + 0.4)) * mesh.force
    return System(name="one", states={"x": x, "v": v}, phase=theta, frequency="omega", contacts=[mesh],
                  derivatives={"x": v, "v": load + force * ca.cos(theta) - 2 * zeta * v - push},
                  parameters={"omega": (omega, 1.0), "zeta": (zeta, 0.05), "load": (load, 0.2),
                              "force": (force, 0.3), "kappa": (kappa, 0.1)})  # fmt: skip


def two_masses() -> System:
    """Backlash to the ground and a one-sided stop between the masses: two ports."""
    x, v, y, w, theta, omega, zeta, load, force, kappa = rs.symbols(
        *["x", "v", "y", "w", "theta", "omega", "z", "F", "a", "k"]
    )
    mesh = rs.dead_zone(x)
    stop = Contact(argument=x - y, breakpoints=(0.5,), slopes=(0.0, 0.7))
    push = (1 + kappa * ca.cos(theta)) * mesh.force
    return System(name="two", states={"x": x, "v": v, "y": y, "w": w}, phase=theta, frequency="omega",
                  contacts=[mesh, stop],
                  derivatives={"x": v, "v": load + force * ca.cos(theta) - 2 * zeta * v - push - stop.force,
                               "y": w, "w": -0.3 * w - 1.7 * y + stop.force + 0.1 * x},
                  parameters={"omega": (omega, 1.0), "zeta": (zeta, 0.05), "load": (load, 0.2),
                              "force": (force, 0.3), "kappa": (kappa, 0.1)})  # fmt: skip


def draw(rng):
    """Random parameters; every second oscillator is forced, the others are excited by their stiffness."""
    forced = rng.integers(2)
    return {
        "omega": rng.uniform(0.4, 2.0),
        "zeta": rng.uniform(0.03, 0.12),
        "load": rng.uniform(0.03, 0.25),
        "force": rng.uniform(0.3, 1.0) if forced else 0.0,
        "kappa": 0.0 if forced else rng.uniform(0.3, 0.6),
    }


class Family:
    """Problems of one System at several numbers of harmonics, moved through the parameters together."""

    def __init__(self, system):
        methods = {H: HarmonicBalance(harmonics=H) for H in (15, 31, 63, FINE)}
        methods["automatic"] = HarmonicBalance(tolerance=1e-5, max_harmonics=FINE)
        self.problems = {key: method.discretise(system, "omega") for key, method in methods.items()}
        self.k = self.problems[FINE].ports.outputs

    def move(self, values):
        for problem in self.problems.values():
            for name, value in values.items():
                problem.set_value(name, value)

    def settle(self, key, u, omega):
        size = Metric(size_of(u), 1.0)
        return correct(self.problems[key], (u, omega), (np.zeros_like(u), 1.0), size, iterations=40).u

    def adapted(self, u, omega):
        problem, u = self.problems["automatic"], resize(u, self.k, 15)
        while True:
            u = self.settle("automatic", u, omega)
            longer, error = problem.adapt(u, omega)
            if len(longer) <= len(u):
                return u, error
            u = longer

    def waveform(self, u):
        return np.fft.irfft(unpack(u, self.k), 4096, axis=0, norm="forward")

    def pairs(self, u, omega):
        """True and claimed error at every number of harmonics, from the true orbit u."""
        true = self.waveform(u)
        for key in (15, 31, 63):
            short = self.settle(key, resize(u, self.k, key), omega)
            yield key, np.abs(self.waveform(short) - true).max(), self.problems[key].error(short, omega)
        short, error = self.adapted(u, omega)
        if len(short) < len(u) // 2:
            yield "automatic", np.abs(self.waveform(short) - true).max(), error

    def changes_contact(self, u, omega):
        problem = self.problems[FINE]
        for i, contact in enumerate(problem.system.contacts):
            argument = problem.forces.argument(i, unpack(u, self.k), problem.vector(omega))
            if find_pattern(argument, contact).phases.size:
                return True
        return False


def claims():
    """Pairs of true and claimed error of at least 200 random backlash orbits, per number of harmonics."""
    rng, found, orbits = np.random.default_rng(2024), {}, 0
    families = [Family(one_mass()), Family(two_masses())]
    for trial in range(400):
        family, values = families[trial % 4 == 3], draw(rng)
        try:
            family.move(values)
            coarse = family.problems[15]
            u = coarse.unknown(coarse.guess(omega=values["omega"]))
        except NoConvergence:
            continue
        for _ in range(8):  # neighbours in all parameters, each corrected from the one before
            omega = values["omega"]
            try:
                u = family.settle(FINE, resize(u, family.k, FINE), omega)
                new = list(family.pairs(u, omega)) if family.changes_contact(u, omega) else []
            except NoConvergence:
                break
            orbits += bool(new)
            for key, true, claimed in new:
                found.setdefault(key, []).append((true, claimed))
            values = {name: value * rng.uniform(0.93, 1.07) for name, value in values.items()}
            family.move(values)
        if orbits >= 200:
            break
    return orbits, {key: np.array(pairs) for key, pairs in found.items()}


def test_true_error_lies_within_the_claim():
    """Fixed and chosen numbers of harmonics in one test, so that the orbits are found once."""
    orbits, found = claims()
    assert orbits >= 200
    assert set(found) == {15, 31, 63, "automatic"}
    for key, pairs in found.items():
        true, claimed = pairs.T
        assert len(true) > (100 if key == "automatic" else 190)
        ratio = true / claimed
        assert np.mean(ratio < 3) >= 0.95
        assert np.median(ratio) > 0.1  # nor is it hopelessly pessimistic


@pytest.mark.parametrize("name", general.GENERAL)
def test_claims_of_contacts_that_do_not_enter_linearly(name):
    system = general.GENERAL[name]()
    omega = system.defaults["omega"]
    coarse = HarmonicBalance(harmonics=31).discretise(system, "omega").guess(omega=omega)
    fine = HarmonicBalance(harmonics=FINE).discretise(system, "omega").from_orbit(coarse)
    C = HarmonicBalance(harmonics=31).discretise(system, "omega").ports.linear(system.parameter_vector()).C
    true = np.abs((coarse.evaluate(THETA) - fine.evaluate(THETA)) @ C.T).max()
    assert true < 3 * coarse.error
    assert true > 0.02 * coarse.error


# ------------------------------------------------------------------------------------------------ the exact waveform
@pytest.mark.parametrize(
    ("build", "omega"),
    [
        (rs.backlash, 0.6),
        (rs.backlash, 0.75),
        (rs.backlash, 1.0),
        (rs.parametric_backlash, 0.9),
        (rs.parametric_backlash, 1.5),
    ],
)
def test_waveform_of_63_harmonics_is_the_exact_one(build, omega):
    """Event-exact shooting from the same orbit: the displacement agrees within 1e-6, and within the claim."""
    orbit = HarmonicBalance(harmonics=63).discretise(build(), "omega").guess(omega=omega)
    exact = Shooting().discretise(build(), "omega").from_orbit(orbit)
    off = np.abs(orbit.evaluate(THETA) - exact.evaluate(THETA))[:, 0].max()
    assert off < 1e-6
    assert off < 3 * orbit.error + exact.error


# ------------------------------------------------------------------------------------------------ rates
def errors(system, omega, numbers, finest):
    problems = {H: HarmonicBalance(harmonics=H).discretise(system, "omega") for H in (*numbers, finest)}
    orbit = problems[numbers[-1]].guess(omega=omega)
    true = problems[finest].solve(orbit, omega).evaluate(THETA)[:, 0]
    return np.array([np.abs(problems[H].solve(orbit, omega).evaluate(THETA)[:, 0] - true).max() for H in numbers])


@pytest.mark.parametrize(("build", "omega"), [(rs.backlash, 1.0), (rs.parametric_backlash, 0.9)])
def test_waveform_with_backlash_converges_with_the_third_power_or_better(build, omega):
    numbers = np.array([15, 31, 63, 127, 255])
    found = errors(build(), omega, numbers.tolist(), 1023)
    assert np.polyfit(np.log(numbers), np.log(found), 1)[0] < -2.9
    assert found[-1] < 1e-8


@pytest.mark.parametrize(("build", "omega"), [(rs.duffing, 0.6), (rs.absorber, 1.05)])
def test_smooth_waveform_converges_faster_than_any_power(build, omega):
    """The slope in a doubly logarithmic plot steepens without end; the error ends at rounding."""
    numbers = [3, 7, 15, 31]
    found = errors(build(), omega, numbers, 63)
    falls = -np.diff(np.log(np.maximum(found, 1e-16))) / np.diff(np.log(numbers))
    resolved = found[1:] > 1e-12
    assert np.all(np.diff(falls[: resolved.sum() + 1]) > 0)
    assert falls.max() > 8
    assert found[-1] < 1e-12


@pytest.fixture(scope="module")
def folds():
    """Branches through a fold: system, span, and the orbit before the fold that its neighbours start from."""
    out = {}
    for build, span in ((rs.backlash, (0.95, 0.65)), (rs.duffing, (1.0, 1.3))):
        problem = HarmonicBalance().discretise(build(), "omega")
        branch = trace(problem, problem.guess(omega=span[0]), span)
        out[build] = next(p for p in branch.special_points if p.kind == "fold"), branch
    return out


@pytest.mark.parametrize(
    ("build", "method"),
    [
        (rs.backlash, HarmonicBalance()),
        (rs.backlash, Shooting()),
        (rs.duffing, HarmonicBalance()),
        (rs.duffing, Shooting()),
        (rs.duffing, Collocation()),
    ],
)
@pytest.mark.parametrize("distance", [1e-5, 1e-8, 1e-10, 1e-11])
def test_bars_next_to_a_fold_hold_the_multiplier_at_the_same_parameter(folds, build, method, distance):
    fold, branch = folds[build]
    before = branch.orbits[fold.index]
    value = fold.parameter - distance * np.sign(fold.parameter - before.value)
    problem = method.discretise(build(), "omega")
    orbit = problem.solve(problem.from_orbit(before), value)
    exact = Shooting(rtol=1e-13, atol=1e-14).discretise(build(), "omega").from_orbit(orbit)
    i, j = (int(np.argmin(abs(o.multipliers - 1))) for o in (orbit, exact))
    off = abs(orbit.multipliers[i] - exact.multipliers[j])
    assert off <= orbit.multiplier_error[i] + exact.multiplier_error[j]
    assert orbit.multiplier_error[i] < 0.1 * np.sqrt(distance) + 1e-8 / np.sqrt(distance)  # and says something
    assert orbit.stability in (exact.stability, "undecided")
