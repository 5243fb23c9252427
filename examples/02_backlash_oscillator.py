"""A mass in a gap: the response softens as soon as contact is lost, and jumps between two folds.

x'' + 2 zeta x' + f(x) = F_m + F_ah omega^2 cos(theta), f the dead zone of half width 1.
"""

import casadi as ca
import numpy as np

from continuation import Contact, HarmonicBalance, System, trace

ZETA, F_M, F_AH = 0.05, 0.1, 0.05


def build() -> System:
    """The contact is declared; nothing is smoothed."""
    x, v, theta, omega = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega"))
    mesh = Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0), name="mesh")
    return System(
        name="backlash oscillator",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": F_M + F_AH * omega**2 * ca.cos(theta) - 2 * ZETA * v - mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[mesh],
    )


def main() -> dict:
    """Return the branch, its folds, and the response at omega = 1 with its dynamic factor."""
    problem = HarmonicBalance().discretise(build(), parameter="omega")
    branch = trace(problem, problem.guess(omega=0.5), span=(0.5, 1.6))
    orbit = problem.solve(branch.orbits[int(np.argmin(np.abs(branch.parameter - 1.0)))], 1.0)
    smallest, largest = orbit.extremes("x")
    return {
        "branch": branch,
        "folds": [p.parameter for p in branch.special_points if p.kind == "fold"],
        "rms": orbit.rms("x"),
        "smallest": smallest,
        "dynamic factor": (largest - 1.0) / F_M,  # largest contact force over the mean one
        "separated": float(np.mean(orbit.evaluate(np.linspace(0, 2 * np.pi, 4000))[:, 0] < 1.0)),
    }


if __name__ == "__main__":
    result = main()
    print(result["branch"])
    print(f"at omega = 1: rms {result['rms']:.6f}, dynamic factor {result['dynamic factor']:.5f},")
    print(f"tooth separated {100 * result['separated']:.1f} % of the time, smallest x = {result['smallest']:.4f}")
