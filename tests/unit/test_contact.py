"""Contact: exact law, modes, and a smoothed family that tends to it."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from continuation import Contact

ARGUMENTS = np.linspace(-4.0, 4.0, 401)


@st.composite
def laws(draw):
    gaps = draw(st.lists(st.floats(0.05, 2.0), min_size=1, max_size=4))
    start = draw(st.floats(-2.0, 2.0))
    slopes = draw(st.lists(st.floats(-2.0, 2.0), min_size=len(gaps) + 1, max_size=len(gaps) + 1))
    return Contact(argument=ca.SX.sym("x"), breakpoints=tuple(start + np.cumsum(gaps)), slopes=tuple(slopes))


def evaluate(contact, x, width=0.0):
    return ca.Function("f", [contact.argument], [contact.expression(width)])(x.reshape(1, -1)).full().ravel()


@given(laws())
def test_law_is_zero_at_zero_continuous_and_has_its_slopes(contact):
    assert contact.value(0.0) == pytest.approx(0.0, abs=1e-12)
    for b in contact.breakpoints:
        assert contact.value(b - 1e-9) == pytest.approx(contact.value(b + 1e-9), abs=1e-8)
    edges = np.array(contact.breakpoints)
    inside = np.concatenate([[edges[0] - 1], (edges[1:] + edges[:-1]) / 2, [edges[-1] + 1]])
    slopes = (contact.value(inside + 1e-3) - contact.value(inside - 1e-3)) / 2e-3
    assert slopes == pytest.approx(contact.slopes, abs=1e-9)
    assert contact.mode(inside).tolist() == list(range(len(edges) + 1))


@given(laws())
def test_expression_is_the_law(contact):
    assert evaluate(contact, ARGUMENTS) == pytest.approx(contact.value(ARGUMENTS), abs=1e-12)


@given(laws(), st.floats(1e-4, 0.5))
def test_smoothed_law_is_within_its_bound(contact, width):
    """A corner of jump s is off by at most |s| width / 2, reached at the corner itself."""
    bound = np.abs(np.diff(contact.slopes)).sum() * width / 2
    assert np.abs(evaluate(contact, ARGUMENTS, width) - contact.value(ARGUMENTS)).max() <= bound + 1e-12


def test_smoothing_error_halves_with_the_width_at_a_corner():
    contact = Contact(argument=ca.SX.sym("x"), breakpoints=(1.0,), slopes=(0.0, 2.0))
    errors = [evaluate(contact, np.array([1.0]), w)[0] for w in (0.2, 0.1, 0.05)]
    assert errors == pytest.approx([0.2, 0.1, 0.05], rel=1e-12)


def test_dead_zone():
    contact = Contact(argument=ca.SX.sym("x"), breakpoints=(-1, 1), slopes=(1, 0, 1))
    assert contact.value([[-3.0, -1.0], [0.5, 1.5]]).tolist() == [[-2.0, 0.0], [0.0, 0.5]]
    assert contact.intercepts.tolist() == [1.0, 0.0, -1.0]


@pytest.mark.parametrize(
    ("breakpoints", "slopes", "words"),
    [
        ((1.0,), (1.0,), "expected 2 slopes for 1 breakpoints, got 1"),
        ((1.0, -1.0), (1.0, 0.0, 1.0), "strictly increasing"),
        ((1.0, 1.0), (1.0, 0.0, 1.0), "strictly increasing"),
        ((), (1.0,), "strictly increasing"),
        ((float("nan"),), (0.0, 1.0), "finite"),
        ((0.0,), (0.0, float("inf")), "finite"),
    ],
)
def test_misuse(breakpoints, slopes, words):
    with pytest.raises(ValueError, match=words):
        Contact(argument=ca.SX.sym("x"), breakpoints=breakpoints, slopes=slopes)


def test_contact_is_immutable():
    contact = Contact(argument=ca.SX.sym("x"), breakpoints=(1.0,), slopes=(0.0, 1.0))
    with pytest.raises(AttributeError):
        contact.slopes = (0.0, 2.0)
