"""Roots against closed forms and against SciPy's own search."""

import math

import pytest
from scipy.optimize import brentq

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import bracketed_root

CASES = {
    "Wallis' cubic": (lambda x: x**3 - 2 * x - 5, 2.0, 3.0),
    "exponential, far from both ends": (lambda x: math.exp(x) - 1e6, 0.0, 100.0),
    "a line": (lambda x: 3 * x - 1, -5.0, 2.0),
    "falling": (math.cos, 1.0, 2.0),
}


@pytest.mark.parametrize("case", CASES)
def test_roots_are_those_of_brentq_in_as_many_evaluations(case):
    f, low, high = CASES[case]
    asked = []
    ours = bracketed_root(lambda x: asked.append(x) or f(x), low, high, absolute=1e-15)
    theirs, told = brentq(f, low, high, xtol=1e-15, full_output=True)
    assert ours == pytest.approx(theirs, rel=4e-16)
    assert len(asked) <= told.function_calls + 2


def test_a_jump_is_bracketed_and_an_end_may_be_the_root():
    assert bracketed_root(lambda x: -1 if x < 0.3 else 1, 0, 1, absolute=1e-12) == pytest.approx(
        0.3, abs=1e-12
    )
    assert bracketed_root(lambda x: x - 2, 2, 5, absolute=1e-12) == 2


def test_what_has_no_root_is_refused_with_the_values_at_its_ends():
    with pytest.raises(InvalidInput, match="is 1 at 0 and 2 at 1; give ends of opposite sign"):
        bracketed_root(lambda x: 1 + x, 0, 1, absolute=1e-9)
    with pytest.raises(NumericalFailure, match="within 5 evaluations"):
        bracketed_root(lambda x: x**9, -1, 2, absolute=1e-15, evaluations=5)
