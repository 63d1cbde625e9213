"""The messages people will read: index, value, requirement, remedy."""

from pathlib import Path

import numpy as np
import pytest

from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    as_several,
    check_finite,
    check_positive,
    check_shape,
    match_shape,
)


def test_exceptions_are_also_the_builtin_kinds():
    assert issubclass(InvalidInput, ValueError) and issubclass(UnstableSystem, ValueError)
    assert issubclass(NumericalFailure, ArithmeticError)
    assert all(
        issubclass(kind, AmbroseError) for kind in (InvalidInput, NumericalFailure, UnstableSystem)
    )


def test_finite_names_the_first_offender():
    with pytest.raises(
        InvalidInput, match=r"K\[1, 0\] is nan, but must be finite; .*missing value"
    ):
        check_finite([[1.0, 2.0], [np.nan, np.inf]], "K")
    with pytest.raises(InvalidInput, match=r"K\[0\] is None"):
        check_finite([None, 1.0], "K")
    with pytest.raises(InvalidInput, match="K is inf"):
        check_finite(np.inf, "K")


@pytest.mark.parametrize(
    "bad", [[[1], [1, 2]], "abc", ["1.0", "2.0"], {}, object(), np.array(["2020"], "M8")]
)
def test_not_numeric(bad):
    with pytest.raises(InvalidInput, match="x is not numeric"):
        check_finite(bad, "x")


def test_integers_and_booleans_become_float_and_complex_stays():
    assert check_finite([1, 2], "x").dtype == float
    assert check_finite(True, "x").dtype == float
    assert check_finite([1j], "x").dtype == complex


@pytest.mark.parametrize(
    ("actual", "shape", "fits"),
    [
        ((3, 3), "(n, n)", True),
        ((3, 2), "(n, n)", False),
        ((3,), "(n,)", True),
        ((3,), "(n)", True),
        ((), "()", True),
        ((3,), "()", False),
        ((4, 3, 2), "(..., 3, 2)", True),
        ((3, 2), "(..., 3, 2)", True),
        ((2,), "(..., 3, 2)", False),
        ((5, 2, 2), "(..., n, n)", True),
        ((5, 2, 3), "(..., n, n)", False),
        ((2, 2), "(2, 2)", True),
        ((0, 4), "(n, m)", True),
        ((7, 3), "(4 + n, n)", True),
    ],
)
def test_match_shape(actual, shape, fits):
    assert match_shape(actual, shape, {}) is fits


def test_letters_hold_across_calls():
    sizes = {}
    assert match_shape((3, 2), "(n, m)", sizes) and sizes == {"n": 3, "m": 2}
    assert not match_shape((2,), "(n,)", sizes)


def test_shape_message_states_what_is_known():
    with pytest.raises(
        InvalidInput, match=r"the shape of B is \(2, 3\), but must be \(n, m\), n = 4"
    ):
        check_shape(np.ones((2, 3)), "B", "(n, m)", n=4)


@pytest.mark.parametrize(
    "bad", [0.0, -1.0, np.nan, np.inf, "1", None, [1.0], 1 + 1j, np.ones((1, 1))]
)
def test_positive_refuses(bad):
    with pytest.raises(InvalidInput, match="length"):
        check_positive(bad, "length", "give metres")


def test_positive_accepts():
    assert check_positive(0, "length", "", zero_allowed=True) == 0.0
    assert check_positive(np.float32(2), "length", "") == 2.0
    with pytest.raises(InvalidInput, match="zero or positive; give metres"):
        check_positive(-1, "length", "give metres", zero_allowed=True)


def test_one_or_several_become_a_tuple():
    """A text and a path are one, though both can be gone through or look as if."""
    assert as_several("y_A") == ("y_A",)
    assert as_several(Path("a.csv")) == (Path("a.csv"),)
    assert as_several(["a", "b"]) == as_several(name for name in "ab") == ("a", "b")
    assert as_several(3) == (3,) and as_several(()) == ()
