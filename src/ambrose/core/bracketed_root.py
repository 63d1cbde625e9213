"""A root of one equation in one unknown between two ends of opposite sign.

SciPy's optimisers have the same method; loading them takes longer than a short command may.
"""

from __future__ import annotations

from collections.abc import Callable
from sys import float_info

from ambrose.core.checks import InvalidInput, NumericalFailure


def bracketed_root(
    f: Callable[[float], float],
    low: float,
    high: float,
    *,
    absolute: float,
    relative: float = 4 * float_info.epsilon,
    evaluations: int = 200,
) -> float:
    """The place x between ``low`` and ``high`` where f changes its sign, to within ``absolute`` +
    ``relative`` |x|.

    Inverse quadratic interpolation where it converges, bisection else (Brent, Algorithms for
    Minimization without Derivatives, 1973, chapter 4). Raises InvalidInput where f has one sign at
    both ends, NumericalFailure after so many evaluations.
    """
    a, b = low, high
    fa, fb = f(a), f(b)
    if fa * fb > 0:
        raise InvalidInput(
            f"the function is {fa:.4g} at {low:.4g} and {fb:.4g} at {high:.4g}; give ends of "
            "opposite sign"
        )
    # b is the best place, c the end across the root from it, a the best place before
    c, fc = a, fa
    step = before = b - a
    for _ in range(evaluations):
        if fb * fc > 0:
            c, fc = a, fa
            step = before = b - a
        if abs(fc) < abs(fb):
            a, b, c = b, c, b
            fa, fb, fc = fb, fc, fb
        within, half = (absolute + relative * abs(b)) / 2, (c - b) / 2
        if abs(half) <= within or fb == 0:
            return b
        tried = _interpolated((a, fa), (b, fb), (c, fc))
        # taken where it stays within the bracket, and is less than half of the step before the last
        if (
            abs(before) >= within
            and abs(tried) < min(1.5 * abs(half), abs(before) / 2)
            and (tried * half > 0)
        ):
            before, step = step, tried
        else:
            before = step = half
        a, fa = b, fb
        b += step if abs(step) > within else within * (1 if half > 0 else -1)
        fb = f(b)
    raise NumericalFailure(
        f"no root to {absolute:.2g} within {evaluations} evaluations; is the function continuous "
        f"between {low:.4g} and {high:.4g}?"
    )


def _interpolated(
    last: tuple[float, float], best: tuple[float, float], across: tuple[float, float]
) -> float:
    """The step from the best place to the root of the parabola x(f) through three points, of the
    line through two where the first is the third; 0 where there is none.
    """
    a, fa = last
    b, fb = best
    c, fc = across
    if abs(fa) <= abs(fb):
        return 0.0
    s = fb / fa
    if a == c:
        # x = b + (c - b) f(b)/(f(b) - f(c))
        return (c - b) * s / (s - 1) if s != 1 else 0.0
    # Lagrange's x(0) with q = f(a)/f(c), r = f(b)/f(c), s = f(b)/f(a)
    q, r = fa / fc, fb / fc
    below = (q - 1) * (r - 1) * (s - 1)
    return -s * ((c - b) * q * (q - r) - (b - a) * (r - 1)) / below if below else 0.0
