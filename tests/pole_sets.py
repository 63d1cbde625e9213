"""Sets of poles compared without an order."""

import numpy as np
from scipy.optimize import linear_sum_assignment


def matched(found, expected):
    """``found`` (n,) in the order of ``expected`` (n,), each to its nearest, for a comparison by
    pytest.approx.

    Two planes have the same poles: sorted by real part, rounding decides which of s and its
    conjugate comes first, and does so in other ways on other processors.
    """
    found, expected = np.asarray(found), np.asarray(expected)
    assert len(found) == len(expected)
    _, order = linear_sum_assignment(np.abs(expected[:, None] - found))
    return found[order]
