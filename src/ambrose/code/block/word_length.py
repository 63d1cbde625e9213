"""What a word length does to the controller: rounded coefficients, moved poles, changed gain, and
rounding while it runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.code.block.block import block_slices
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.fixed_point import accumulate_rounding
from ambrose.core.checks import invalid

BITS = (8, 12, 16, 24, 32, 53)  # of a mantissa that are tried; 24 is float, 53 double
MANTISSA = {"double": 53, "float": 24}  # bits
_ANGLES = np.geomspace(1e-6, 0.999, 200) * np.pi  # per sample, up to the Nyquist frequency


@dataclass(frozen=True, slots=True)
class WordLength:
    """gain_error [-]: of the response, relative to its largest singular value at each frequency;
    pole_shift [-]: relative to the pole's distance from z = 1.
    """

    bits: int
    gain_error: float
    pole_shift: float


def round_to_bits(x: np.ndarray, bits: int) -> np.ndarray:
    """x rounded to ``bits`` bits of mantissa. Raises InvalidInput."""
    if not 2 <= bits <= 53:
        raise invalid(
            "bits", bits, "from 2 to 53 bits of mantissa", "24 is single precision, 53 double"
        )
    mantissa, exponent = np.frexp(x)
    return np.ldexp(np.round(np.ldexp(mantissa, bits)), exponent - bits)


def word_lengths(block: ControlBlock, bits: tuple[int, ...] = BITS) -> tuple[WordLength, ...]:
    """The effect of each word length on the block between its limits."""
    law = (block.increment, block.B, block.C, block.D)
    return tuple(
        WordLength(count, gain_error(*law, count), _pole_shift(block, count)) for count in bits
    )


def gain_error(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, bits: int
) -> float:
    """What rounding A - I, B, C and D to ``bits`` bits of mantissa does to the response, relative
    to its largest singular value at each frequency: the largest, from 1e-6 of the Nyquist frequency
    up to it.
    """
    exact = sampled_response(increment, B, C, D)
    return response_error(
        exact, sampled_response(*(round_to_bits(x, bits) for x in (increment, B, C, D)))
    )


def response_error(exact: np.ndarray, found: np.ndarray, floor: float = 0.0) -> float:
    """How far responses (w, p, m) are from exact ones, relative to the largest singular value
    there: the largest. floor: of the median gain, below which gains count as that large (a notch's
    zero, Tustin's at the Nyquist frequency).
    """
    size = np.linalg.norm(exact, 2, axis=(1, 2))

    # gains below the floor count as the floor: relative errors at a zero mean nothing
    size = np.maximum(size, max(floor * float(np.median(size)), np.finfo(float).tiny))
    return float((np.linalg.norm(found - exact, 2, axis=(1, 2)) / size).max())


def sampled_response(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> np.ndarray:
    """C (delta - increment)^-1 B + D (w, p, m), with delta = z - 1 evaluated without
    cancellation.
    """
    if not len(increment):
        return np.broadcast_to(D, (len(_ANGLES), *D.shape)).astype(complex)

    # delta = exp(j angle) - 1 without cancellation
    inner = np.expm1(1j * _ANGLES)[:, None, None] * np.eye(len(increment)) - increment
    return C @ np.linalg.solve(inner, np.broadcast_to(B, (len(_ANGLES), *B.shape))) + D


def _pole_shift(block: ControlBlock, bits: int) -> float:
    worst = 0.0
    for own in block_slices(block.sizes):
        old = np.sort_complex(np.linalg.eigvals(block.increment[own, own]))
        new = np.sort_complex(np.linalg.eigvals(round_to_bits(block.increment[own, own], bits)))

        # eigenvalues of A - I: distance from z = 1; an integrator's is zero and has no
        # relative shift
        size = np.abs(old)
        worst = max(worst, float((np.abs(new - old)[size > 0] / size[size > 0]).max(initial=0.0)))
    return worst


def floating_error(block: ControlBlock, bits: int) -> np.ndarray:
    """Bound (p,) [A] on what ``bits`` bits of mantissa do to the outputs in HORIZON samples, with
    exact inputs and no limiting.

    First order in 2^-bits: every coefficient and every sum may be off by half a unit; slow states
    are summed with compensation.
    """
    unit, n = 2.0**-bits, block.n_states
    terms = n and max(block.sizes) + len(block.inputs) + 1

    # each sum: a coefficient and a rounding per term, scaled states at most 1
    size = np.abs(block.increment).sum(axis=1) + np.abs(block.B) @ block.error_limit
    source = unit * (1 + terms) * size

    # the state's own sum: its rounding for fast states; for slow ones, compensated, second order
    # and the rounding of the increment
    source[block.winding :] += unit
    source[: block.winding] += 2 * unit**2 * (terms + 1) + 2 * unit * size[: block.winding]

    # outputs: accumulated states, and the rounding of C x + D e
    asked = np.abs(block.C).sum(axis=1) + np.abs(block.D) @ block.error_limit
    states = accumulate_rounding(block, source) + 2 * unit * (np.arange(n) < block.winding)
    return np.abs(block.C) @ states + unit * (2 + n + len(block.inputs)) * asked
