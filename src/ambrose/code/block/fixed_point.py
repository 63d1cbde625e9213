"""The block in whole numbers: Q formats that cannot overflow, chosen row by row, and how far the
result may be off.

Signals are words of ``word`` bits that hold -1..1 as -2^s..2^s, s = word - 2 (errors in
error_limit, currents in current_limit, states in their bound). Sums are accumulated in twice the
word. Coefficients of one row share the factor 2^f, as large as the row's sum allows: sum |c| 2^f
2^s <= 2^(2 word - 2) whatever the signals are. States are kept in double words, with the bits below
the signal's resolution, so that an integrator never loses a small increment (no dead zone, no limit
cycle from it).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import singledispatch
from typing import Any, ClassVar

import numpy as np

from ambrose.code.block.block import ControlBlock, block_slices
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.frequency import peak_gains

WORDS = (16, 32)  # bits of a word that there is code for
HORIZON = 1e6  # samples for which the error bound holds; integrators let it grow with time
LARGEST_ERROR = 1e-3  # of the current limit
_LEAST_BITS = 4
Formats = list[tuple[Sequence[str], np.ndarray, np.ndarray]]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Words:
    """``block`` in words: whole-number coefficients (dtype int64) with the fraction bits of their
    rows.

    unwind (n, p), with unwind_bits (n,); output: currents of signals, with output_bits (p,);
    transfer (n, m + p), with transfer_bits (n,); signal_bits s; state_bits: of the stored states;
    update_shift (n,): by which the sum of a state's increment is shifted; cut_bits (p,): what is
    cut off an output is divided by 2^cut_bits; error (p,) [A]: bound on what rounding does in
    HORIZON samples without limiting, against exact arithmetic with the same inputs.
    """

    number: ClassVar[Any] = np.int64  # of its errors, currents and states

    block: ControlBlock
    word: int
    signal_bits: int
    state_bits: int
    update_shift: np.ndarray
    unwind: np.ndarray
    unwind_bits: np.ndarray
    output: np.ndarray
    output_bits: np.ndarray
    transfer: np.ndarray
    transfer_bits: np.ndarray
    cut_bits: np.ndarray
    error: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def base(self) -> ControlBlock:
        return self.block

    @property
    def edge(self) -> int:
        """The largest plausible error."""
        return 1 << self.signal_bits

    @property
    def fixed_increment(self) -> np.ndarray:
        """A - I (n, n); of a cascade nothing, which its sections say."""
        return np.zeros(self.block.increment.shape, np.int64)

    def section_tables(self) -> dict[str, np.ndarray]:
        """What a cascade has besides: mixings, channels and orders."""
        return {}

    def said(self) -> dict[str, Any]:
        """What the templates ask of its form."""
        return self.block.said()

    def listing(self) -> Sequence[tuple[Any, Sequence[float], float]]:
        """Every section of a cascade, its coefficients, and its largest output [m]."""
        return ()

    def tables(self) -> dict[str, np.ndarray]:
        """The numbers of the code, as they lie in memory."""
        m, w = len(self.block.inputs), self.block.winding
        return {
            "unwind": self.unwind[:w].T,
            "update_shift": self.update_shift,
            "unwind_shift": self.unwind_bits[:w] + self.signal_bits - self.state_bits,
            "output_bits": self.output_bits,
            "cut_bits": self.cut_bits,
            "transfer_error": self.transfer[:, :m].T,
            "transfer_current": self.transfer[:, m:].T,
            "transfer_bits": self.transfer_bits + self.signal_bits,
        }

    def formats(self) -> Formats:
        """The rows' names, coefficients and bits, of outputs, unwinding and transfer."""
        block, states = self.block, [f"x[{i}]" for i in range(self.block.n_states)]
        unwound, tracked = (
            [f"{what} {state}" for state in states[:count]]
            for what, count in (
                ("unwind", block.winding),
                ("track", block.n_states * block.transfers),
            )
        )
        return [
            (block.outputs, self.output, self.output_bits),
            (unwound, self.unwind, self.unwind_bits),
            (tracked, self.transfer, self.transfer_bits),
        ]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixedBlock(Words):
    """update (n, n + m): increment and B, with update_bits (n,); output (p, n + m): C and D."""

    update: np.ndarray
    update_bits: np.ndarray

    @property
    def fixed_increment(self) -> np.ndarray:
        return self.update[:, : self.block.n_states]

    def tables(self) -> dict[str, np.ndarray]:
        n = self.block.n_states
        C, D = np.split(self.output, [n], axis=1)
        return {**Words.tables(self), "B": self.update[:, n:].T, "C": C.T, "D": D.T}

    def formats(self) -> Formats:
        names = [f"x[{i}]" for i in range(self.block.n_states)]
        return [(names, self.update, self.update_bits), *Words.formats(self)]


@singledispatch
def in_words(block: ControlBlock, word: int = 32, largest_error: float = LARGEST_ERROR) -> Words:
    """The block in words of 16 or 32 bits.

    largest_error [-]: of the current limit, that rounding may cause (of a cascade the noise of
    rounding, root mean square). Raises InvalidInput for words in which a sum overflows, the error
    is larger, or rounded coefficients of a cascade move the response by more than
    ``cascade.LARGEST_GAIN_ERROR``.
    """
    # coefficients between parts of limits, in words row by row
    update = np.hstack([block.increment, block.B * block.error_limit])
    output = np.hstack([block.C, block.D * block.error_limit]) / block.current_limit[:, None]
    whole, bits = quantise_rows(update, word, "a state's increment")
    fixed = FixedBlock(update=whole, update_bits=bits, **in_common(block, word, bits, output))

    # what rounding does, as a share of the limit
    error = _error(fixed, update, output)
    share = error / block.current_limit
    if not share.max() <= largest_error:
        raise invalid(
            f"the rounding error of {block.outputs[int(share.argmax())]} with words of {word} bits",
            f"{share.max():.2g} of its limit",
            f"at most {largest_error:g}",
            "use words of 32 bits or floating point, narrow error_limit, or shorten windup_time",
        )
    return replace(fixed, error=error)


def in_common(
    block: ControlBlock, word: int, bits: np.ndarray, output: np.ndarray
) -> dict[str, Any]:
    """What every form has in words. bits (n,): behind the point of the states' increments; output:
    currents of signals, both in parts of their limits. Raises InvalidInput.
    """
    if word not in WORDS:
        raise invalid("word", word, "16 or 32 bits", "choose one of them")
    s = word - 2
    u, reach = block.current_limit, block.state_range[:, None]

    # what is cut off an output is up to 2^cut_bits times its limit
    cut_bits = np.ceil(np.log2(block.raw_limit / u)).astype(int)
    q_output, output_bits = quantise_rows(output, word, "an output")
    unwind, unwind_bits = quantise_rows(
        block.unwind * u * np.exp2(cut_bits) / reach, word, "a state's unwinding"
    )

    # states at transfer from errors (m) and currents (p); large coefficients may have negative
    # fraction bits
    transfer, transfer_bits = quantise_rows(
        np.hstack([block.from_error * block.error_limit, block.from_output * u]) / reach,
        word,
        "a state at transfer",
        least=_LEAST_BITS - s,
        most=2 * word - 3 - s,
    )

    # a state and two increments fit into the double word
    smallest = min(bits.min(initial=2 * word), unwind_bits.min(initial=2 * word))
    state_bits = min(2 * word - 4, int(smallest) + s - 1)
    if state_bits < s:
        raise InvalidInput(
            "fixed point overflows: a state grows by more than its range in one sample and keeps "
            f"{state_bits} bits of {s}; use words of 32 bits, or floating point"
        )
    return {
        "block": block,
        "word": word,
        "signal_bits": s,
        "state_bits": state_bits,
        "update_shift": bits + s - state_bits,
        "unwind": unwind,
        "unwind_bits": unwind_bits,
        "output": q_output,
        "output_bits": output_bits,
        "transfer": transfer,
        "transfer_bits": transfer_bits,
        "cut_bits": cut_bits,
    }


def quantise_rows(
    matrix: np.ndarray, word: int, what: str, least: int = 0, most: int = 100
) -> tuple[np.ndarray, np.ndarray]:
    """Whole numbers and fraction bits of every row: each below 2^(word-1), their sum at most
    2^word.
    """
    bits = np.zeros(len(matrix), int)
    whole = np.zeros(matrix.shape, np.int64)
    for i, row in enumerate(matrix):
        largest, total = np.abs(row).max(initial=0.0), np.abs(row).sum()
        f = word - 1

        # largest 2^f < 2^(word-1) and sum 2^f <= 2^word
        if largest > 0:
            f = int(np.floor(min(word - 1 - np.log2(largest), word - np.log2(total))))
        f = min(f, most, 2 * word - 3)  # a shift by the double word's bits is undefined

        # rounding may lift an entry or the sum over its limit: a bit less then
        while True:
            scaled = np.round(row * np.exp2(f))
            if (
                np.abs(scaled).max(initial=0.0) < 2.0 ** (word - 1)
                and np.abs(scaled).sum() <= 2.0**word
            ):
                break
            f -= 1
        if f < least:
            raise InvalidInput(
                f"fixed point overflows: {what} adds up to {total:.3g} times its range, more "
                f"than the range of {word}-bit words; "
                "use words of 32 bits or floating point, or raise the current limit"
            )
        whole[i], bits[i] = scaled.astype(np.int64), f
    return whole, bits


def _error(fixed: FixedBlock, update: np.ndarray, output: np.ndarray) -> np.ndarray:
    """Bound (p,) [A] on the outputs' error against the exact block with the same whole-number
    inputs, while none is limited.
    """
    block, n = fixed.block, fixed.block.n_states
    half = 0.5 * 2.0**-fixed.signal_bits

    # increments: rounded coefficients at signals of 1, states rounded to words, bits of the state
    wrong = np.abs(fixed.update * np.exp2(-fixed.update_bits)[:, None] - update).sum(axis=1)
    source = wrong + half * np.abs(update[:, :n]).sum(axis=1) + 0.5 * 2.0**-fixed.state_bits

    # outputs: accumulated and read states, rounded coefficients, and the output's own rounding
    wrong = np.abs(fixed.output * np.exp2(-fixed.output_bits)[:, None] - output).sum(axis=1)
    return block.current_limit * (
        np.abs(output[:, :n]) @ (accumulate_rounding(block, source) + half) + wrong + half
    )


def accumulate_rounding(
    block: ControlBlock, source: np.ndarray, steps: float = HORIZON
) -> np.ndarray:
    """How far the states (n,) can be off when every one of so many samples adds an error up to
    ``source`` (n,).
    """
    result = np.zeros(block.n_states)

    # block by block of the diagonal: the others are zero
    for own in block_slices(block.sizes):
        result[own] = peak_gains(block.increment[own, own], np.diag(source[own]), steps).sum(axis=1)
    return result


# What a word length does to the controller: rounded coefficients, moved poles, changed gain, and
# rounding while it runs.


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


@singledispatch
def word_lengths(block: ControlBlock, bits: tuple[int, ...] = BITS) -> tuple[WordLength, ...]:
    """The effect of each word length on the block between its limits; of a cascade, whose sections
    are rounded one by one, without the shift of its poles.
    """
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


@singledispatch
def floating_error(block: ControlBlock, bits: int, steps: float = HORIZON) -> np.ndarray:
    """Bound (p,) [A] on what ``bits`` bits of mantissa do to the outputs in so many samples, with
    exact inputs and no limiting.

    First order in 2^-bits: every coefficient and every sum may be off by half a unit; slow states,
    of a cascade all, are summed with compensation.
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
    states = accumulate_rounding(block, source, steps) + 2 * unit * (np.arange(n) < block.winding)
    return np.abs(block.C) @ states + unit * (2 + n + len(block.inputs)) * asked
