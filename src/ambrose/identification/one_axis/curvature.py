"""Whether the motion is large enough to see that a magnet is no spring: quadratic and cubic terms
of the force, and by how much the tangent differs from what a straight plant finds.

F = c (i/s)^2 about a working point is k_s y + k_i i + q_1 y^2 + q_2 y i + q_3 i^2 + cubic terms.
The cubic ones act on the linear fit like another k_s and k_i, by about the square of motion over
gap.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from ambrose.identification.one_axis.model import DELAY, STIFFNESS, input_polynomials
from ambrose.identification.one_axis.prediction_error import Fit

_POWERS = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))  # of y and u


def curvature(fit: Fit, y: np.ndarray, u: np.ndarray) -> tuple[float, np.ndarray]:
    """Probability by chance of what these seven terms explain, and the plant (m,) at the tangent
    less the straight one.

    y, u (n,) in the record's own scale. One step of Gauss and Newton with the terms as further
    unknowns; they enter linearly, so that it is exact but for the plant's own change.
    """
    structure = fit.structure
    plant, _, C, D = structure.split(fit.unknowns)
    shift = max(round(float(plant[DELAY])), 0)
    late = np.concatenate([np.zeros(shift), u[: len(u) - shift]])
    numerator, _ = input_polynomials(np.array([plant[STIFFNESS], 1.0, 0.0]))
    columns = [
        -lfilter(D, C, lfilter(numerator, [1.0], y**own * late**driven))[fit.first :]
        for own, driven in _POWERS
    ]
    jacobian = np.column_stack([fit.jacobian, *columns])
    size = np.sqrt((jacobian**2).sum(axis=0)) + 1e-300
    solution = np.linalg.lstsq(jacobian / size, -fit.counted, rcond=1e-10)[0] / size
    left = fit.counted + jacobian @ solution
    gain = len(left) * float(np.log(np.sum(fit.counted**2) / np.sum(left**2)))
    return float(chi2.sf(gain, len(_POWERS))), solution[: structure.plant]
