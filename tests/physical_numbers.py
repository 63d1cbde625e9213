"""Random numbers as measurements give them: zero, or of a size that still means something beside
the others.
"""

from hypothesis import strategies as st

_LEAST = 1e-9  # of the largest number of the range


def physical(low: float, high: float) -> st.SearchStrategy[float]:
    """Floats from low to high; what is below a billionth of the largest is zero: no inertia of
    5e-324 kg m^2.
    """
    least = _LEAST * max(abs(low), abs(high))
    return st.floats(low, high).map(lambda x: x if abs(x) >= least else max(low, 0.0))
