"""Duffing's oscillator: response curve, stability, folds, and the region of two responses in two parameters."""

import casadi as ca

from continuation import HarmonicBalance, Shooting, System, trace, track


def build() -> System:
    """x'' + 0.05 x' + x + 0.1 x^3 = g cos(theta), theta' = omega."""
    x, v, theta, omega, g = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega", "g"))
    return System(
        name="duffing",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.05 * v - x - 0.1 * x**3 + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0), "g": (g, 0.18)},
    )


def main() -> dict:
    """Return the branch, its upper fold by shooting, and the curve of the upper fold over the load."""
    duffing = build()
    problem = HarmonicBalance().discretise(duffing, parameter="omega")  # harmonics chosen by the error estimate
    branch = trace(problem, problem.guess(omega=0.5), span=(0.5, 2.0))

    upper = branch.special_points[0]
    other = Shooting().discretise(duffing, parameter="omega")  # another method, the same calls
    near = branch.orbits[upper.index - 5]
    check = trace(other, other.solve(near, near.value), span=(near.value, 1.3))

    curve = track(upper, parameters=("omega", "g"), span={"g": (0.15, 0.2)})
    return {
        "branch": branch,
        "folds": [p.parameter for p in branch.special_points],
        "fold by shooting": check.special_points[0].parameter,
        "curve": curve,
    }


if __name__ == "__main__":
    result = main()
    print(result["branch"])
    print(f"upper fold by shooting: omega = {result['fold by shooting']:.9f}")
    print(result["curve"])
