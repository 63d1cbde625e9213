"""The test-time shape check catches a docstring that lies, and leaves honest calls alone."""

import numpy as np
import pytest

import shape_contract
from ambrose.core import frequency, mechanical, sampling
from shape_contract import checked, stated_shapes


def honest(A, b=None, count=2, name=""):
    """A (n, n) [N/m]: a matrix; b (n,) or (n, k): optional; other (q,): no parameter; name (of the
    axis): prose.
    """
    return A


def lying(A, b):
    """A (n, n), b (n,)."""
    return np.shape(A), np.shape(b)


def counted(shapes, count):
    """shapes (n, count): as many columns as asked for, 4 + 2 n rows in general."""


def test_reads_parameters_only():
    assert stated_shapes(honest) == {"A": ["(n, n)"], "b": ["(n)", "(n, k)"]}
    assert stated_shapes(counted) == {"shapes": ["(n, count)"]}


@pytest.mark.parametrize("b", [None, [1, 2], np.ones(2), np.ones((2, 5))])
def test_honest_calls_pass(b):
    A = [[1, 2], [3, 4]]
    assert checked(honest)(A, b=b) is A


@pytest.mark.parametrize(
    ("A", "b", "named"),
    [
        (np.ones((2, 3)), np.ones(2), "took A with shape \\(2, 3\\)"),
        (np.eye(2), np.ones(3), "took b with shape \\(3,\\)"),
        (np.eye(2), np.ones((2, 1)), "docstring says \\(n\\)"),
        (np.eye(2), 1.0, "shape \\(\\)"),
    ],
)
def test_a_lie_is_caught(A, b, named):
    with pytest.raises(AssertionError, match=named):
        checked(lying)(A, b)


def test_integer_arguments_fix_letters():
    checked(counted)(np.ones((5, 3)), 3)
    with pytest.raises(AssertionError, match="count"):
        checked(counted)(np.ones((5, 3)), count=4)


def test_a_refusal_is_no_lie():
    @checked
    def refuses(A):
        """A (n, n)."""
        raise ValueError("not square")

    with pytest.raises(ValueError, match="not square"):
        refuses(np.ones((2, 3)))


def test_the_package_is_wrapped():
    for function in (frequency.frequency_response, frequency.evaluate, mechanical.undamped_modes):
        assert hasattr(function, "__wrapped__"), f"{function.__qualname__} escaped the contract"
    assert not hasattr(sampling.pade, "__wrapped__")  # states no shapes
    shape_contract.install()  # once is enough
    assert sum(type(finder).__name__ == "_Finder" for finder in __import__("sys").meta_path) == 1
