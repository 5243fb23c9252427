"""Poincare sections: points lie on the section, and on known orbits."""

import numpy as np
import pytest
from reference_systems import backlash, gear, symbols

from continuation import System
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.sections import ContactChange, Crossing, Stroboscopic, poincare_section
from continuation.timedomain.simulate import EventExact

HIGH = np.array([0.8338430125, 0.1640787518])
INTEGRATORS = (FixedStep(), EventExact())
both = pytest.mark.parametrize("integrator", INTEGRATORS, ids=["fixed", "exact"])


@both
def test_stroboscopic_section_of_a_known_orbit(integrator):
    met = poincare_section(backlash(), HIGH, Stroboscopic(), count=60, transient=3, integrator=integrator, omega=0.75)
    assert met.points.shape == (60, 2)
    assert abs(met.points - HIGH).max() < 1e-8
    assert met.phases == pytest.approx(2 * np.pi * np.arange(60))
    later = poincare_section(
        backlash(), HIGH, Stroboscopic(1.0), count=2, transient=0, integrator=integrator, omega=0.75
    )
    assert met.phases[1] + 1 == pytest.approx(later.phases[1])


@both
def test_contact_onset_and_loss(integrator):
    settings = {"count": 55, "transient": 10, "integrator": integrator, "omega": 0.75}
    onset, loss = (poincare_section(backlash(), HIGH, ContactChange(direction=d), **settings) for d in (1, -1))
    for met, sign in ((onset, 1), (loss, -1)):
        assert abs(met.column("x") - 1).max() < 1e-12
        assert np.all(sign * met.column("v") > 0)
        assert np.diff(met.phases) == pytest.approx(2 * np.pi, abs=1e-6)
        assert np.ptp(met.points, axis=0).max() < 1e-7
    closed = (loss.phases[1] - onset.phases[1]) % (2 * np.pi) / (2 * np.pi)
    assert closed == pytest.approx(1 - 0.54175, abs=3e-6)
    coast = poincare_section(backlash(), HIGH, ContactChange(breakpoint=0), **{**settings, "count": 1}, limit=20)
    assert coast.points.shape == (0, 2)  # the other flank is never met


@both
def test_crossing_of_a_level_does_not_change_the_motion(integrator):
    """Lorenz section z = r - 1: points on it, either direction, and the successive maxima fold over as a tent."""
    x, y, z = symbols("x", "y", "z")
    rates = {"x": 10 * (y - x), "y": x * (28 - z) - y, "z": x * y - 8 / 3 * z}
    lorenz = System(name="lorenz", states={"x": x, "y": y, "z": z}, derivatives=rates, parameters={},
                    outputs={"rate": x * y - 8 / 3 * z})  # fmt: skip
    start = [1.0, 1.0, 20.0]
    up, down, any_ = (
        poincare_section(lorenz, start, Crossing("z", 27.0, d), count=c, transient=20, integrator=integrator)
        for d, c in ((1, 10), (-1, 10), (0, 20))
    )
    assert abs(any_.column("z") - 27).max() < 1e-10
    rising = any_.column("x") * any_.column("y") > 8 / 3 * 27
    assert np.all(rising[::2] != rising[1::2])
    np.testing.assert_allclose(np.sort(np.concatenate([up.phases, down.phases])), any_.phases, rtol=0, atol=1e-5)
    maxima = poincare_section(lorenz, start, Crossing("rate", 0.0, -1), count=40, transient=20, integrator=integrator)
    heights = maxima.column("z")
    assert heights.min() > 27
    order = np.argsort(heights[:-1])
    apart = np.diff(heights[:-1][order]) > 0.2  # the attractor is a thin sheet, not quite a line
    rises = np.diff(heights[1:][order])[apart] > 0
    assert np.all(rises[: np.argmin(rises)])  # the map of one maximum to the next rises, then falls
    assert not np.any(rises[np.argmin(rises) :])


def test_a_section_of_the_gear_by_its_contact_keeps_the_motion():
    system, start = gear(), np.array([1.2, *[0.0] * 13])
    plain = poincare_section(system, start, Stroboscopic(), count=2, transient=200, frequency_ratio=0.62)
    onset = poincare_section(system, start, ContactChange(), count=2, transient=200, frequency_ratio=0.62)
    crossing = poincare_section(system, start, Crossing("lambda", 1.0), count=2, transient=200, frequency_ratio=0.62)
    assert abs(onset.points - crossing.points).max() < 1e-9
    assert 0 < onset.phases[0] < plain.phases[1]


def test_misuse_is_refused():
    def section(which, system=None, **settings):
        return poincare_section(system or backlash(), HIGH, which, **settings)

    x, v = symbols("x", "v")
    free = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, parameters={})
    for which, settings, message in (
        (Stroboscopic(7.0), {}, "phase in"),
        (Stroboscopic(), {"system": free}, "needs a System with a phase"),
        (ContactChange(contact=1), {}, "has 1 contacts"),
        (ContactChange(breakpoint=2), {}, "has 2 breakpoints"),
        (ContactChange(direction=2), {}, "direction must be"),
        (Crossing("y"), {}, "unknown quantity 'y'"),
        (Crossing("contact force"), {}, "contains a contact force"),
        (Stroboscopic(), {"count": 0}, "must be positive"),
        (ContactChange(), {"integrator": FixedStep(land=False)}, "steps over"),
    ):
        with pytest.raises(ValueError, match=message):
            section(which, **settings)
    with pytest.raises(ValueError, match="unknown state"):
        section(Stroboscopic(), count=1, transient=0).column("y")
