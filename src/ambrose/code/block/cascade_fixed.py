"""A filter bank in whole numbers: every signal in parts of its own largest value, no bit of an
increment lost.

Words, rows and sums are those of block/fixed_point.py, with a scale for every channel's input,
section's output and state: its bound (peak gains, Jackson 1970, with the anti-windup). Signals
saturate there all the same. What a shift cuts off a channel's input or a state's increment is kept
for the next sample (fraction saving), so that rounding never adds up in an integrator.

Two errors are told apart. Rounded coefficients are another law, compared by its response. Rounding
while it runs comes from known places: signals, and the words in which states are read; each is
followed to the currents by its peak gain (the bound) and by its energy (the noise expected:
independent errors of 2^-s/sqrt(12), for signals that move by more than a bit).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.code.block.block import block_slices
from ambrose.code.block.cascade import FLOOR, CascadeBlock
from ambrose.code.block.fixed_point import HORIZON, LARGEST_ERROR, WORDS, quantise_rows
from ambrose.code.block.word_length import response_error, round_to_bits, sampled_response
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.peak_gain import peak_gains
from ambrose.law.filters import bank, chain

# of the response by rounded coefficients, a tenth of a decibel; of a tenth of the median gain where
LARGEST_GAIN_ERROR = 0.01
# the response is smaller
_LEAST_BITS = 4
_DOUBLINGS = 13  # 8192 samples of the impulse responses, whose energy gives the noise


@dataclass(frozen=True, slots=True, eq=False)
class FixedCascade:
    """``block`` in words: whole-number coefficients (dtype int64) with the fraction bits of their
    rows.

    sections (s, 3, 3) with section_bits (s, 3): a section's y, x1 and x2 from v, x1 and x2; into
    (c, m), into_bits (c,); output (p, c), output_bits (p,); unwind, transfer, cut_bits, signal_bits
    and state_bits as in ``FixedBlock``; update_shift (n,): by which an increment is shifted; error
    (p,) [A]: bound on what rounding does in HORIZON samples; noise (p,) [A]: its expected root mean
    square; gain_error [-]: of the response, by rounded coefficients.
    """

    block: CascadeBlock
    word: int
    signal_bits: int
    state_bits: int
    into: np.ndarray
    into_bits: np.ndarray
    sections: np.ndarray
    section_bits: np.ndarray
    update_shift: np.ndarray
    output: np.ndarray
    output_bits: np.ndarray
    unwind: np.ndarray
    unwind_bits: np.ndarray
    transfer: np.ndarray
    transfer_bits: np.ndarray
    cut_bits: np.ndarray
    error: np.ndarray
    noise: np.ndarray
    gain_error: float


def to_fixed_cascade(
    block: CascadeBlock, word: int = 32, largest_error: float = LARGEST_ERROR
) -> FixedCascade:
    """The block in words of 16 or 32 bits.

    largest_error [-]: of the current limit, that the noise of rounding may be (root mean square).
    Raises InvalidInput for words in which a sum overflows, the noise is larger, or rounded
    coefficients move the response by more than LARGEST_GAIN_ERROR.
    """
    if word not in WORDS:
        raise invalid("word", word, "16 or 32 bits", "choose one of them")
    s = word - 2
    errors = block.error_limit
    currents = block.current_limit
    channels = _inputs(block)

    # what is cut off an output is up to 2^cut_bits times its limit
    cut_bits = np.ceil(np.log2(block.raw_limit / currents)).astype(int)

    # channels' inputs from errors, both in parts of their ranges; then the sections' rows
    # (y, x1, x2)
    into, into_bits = quantise_rows(
        block.into * errors / channels[:, None], word, "a channel's input"
    )
    rows, names = _section_rows(block)
    whole = [quantise_rows(item, word, name) for item, name in zip(rows, names, strict=True)]
    sections = np.array([table for table, _ in whole], np.int64).reshape(-1, 3, 3)
    section_bits = np.array([bits for _, bits in whole], int).reshape(-1, 3)

    # currents from the channels' last signals; states' unwinding from what is cut off
    last = _outputs(block)
    output, output_bits = quantise_rows(block.out * last / currents[:, None], word, "an output")
    unwind, unwind_bits = quantise_rows(
        block.unwind * currents * np.exp2(cut_bits) / block.bound[:, None],
        word,
        "a state's unwinding",
    )

    # states at transfer from errors (m) and currents (p); large coefficients may have
    # negative fraction bits
    transfer, transfer_bits = quantise_rows(
        np.hstack([block.from_error * errors, block.from_output * currents]) / block.bound[:, None],
        word,
        "a state at transfer",
        least=_LEAST_BITS - s,
        most=2 * word - 3 - s,
    )

    # sums have s + bits of the row; shifted by update_shift they have the state's bits
    own = _state_rows(block, section_bits)
    smallest = min(own.min(initial=2 * word), unwind_bits.min(initial=2 * word))
    # a state and two increments fit into the double word
    state_bits = min(2 * word - 4, int(smallest) + s - 1)
    if state_bits < s:
        raise InvalidInput(
            "fixed point overflows: a state grows by more than its range in one sample and keeps "
            f"{state_bits} bits of {s}; "
            "use words of 32 bits, or floating point"
        )
    fixed = FixedCascade(
        block,
        word,
        s,
        state_bits,
        into,
        into_bits,
        sections,
        section_bits,
        own + s - state_bits,
        output,
        output_bits,
        unwind,
        unwind_bits,
        transfer,
        transfer_bits,
        cut_bits,
        np.zeros(0),
        np.zeros(0),
        0.0,
    )

    # rounded coefficients: another law; rounding while it runs: noise
    error, noise = _rounding(fixed)
    moved = response_error(
        sampled_response(*block_law(block)), sampled_response(*_running_law(fixed)), FLOOR
    )
    if moved > LARGEST_GAIN_ERROR:
        raise invalid(
            f"the error of the response by coefficients of {word} bits",
            f"{moved:.2g} of its gain",
            f"at most {LARGEST_GAIN_ERROR:g}",
            "use words of 32 bits or floating point, or sample more slowly: slow sections have "
            "small coefficients",
        )
    share = noise / currents
    if not share.max() <= largest_error:
        # noise goes with the signals' ranges, hence with error_limit: a tenth below what would
        # just do
        worst = int(share.argmax())
        narrow = 0.9 * largest_error / share.max() * errors.min()
        raise invalid(
            f"the rounding noise of {block.outputs[worst]} with words of {word} bits",
            f"{share.max():.2g} of its limit",
            f"at most {largest_error:g}",
            f"{block.raw_limit[worst] / currents[worst]:.3g} times the limit is asked for at the "
            "largest error: narrow "
            f"error_limit to {narrow:.1g} m, take away gain at high frequencies, or use words of "
            "32 bits or floating point",
        )
    return replace(fixed, error=error, noise=noise, gain_error=moved)


def block_law(block: CascadeBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A - I, B, C and D."""
    return block.increment, block.B, block.C, block.D


def cascade_error(block: CascadeBlock, bits: int, steps: float = HORIZON) -> np.ndarray:
    """Bound (p,) [A] on what ``bits`` bits of mantissa do to the outputs in so many samples, with
    exact inputs and no limiting.

    First order in 2^-bits: every coefficient and every sum may be off by half a unit; states are
    summed with compensation.
    """
    unit = 2.0**-bits
    inputs = _inputs(block)
    outputs = block.signals[len(block.into) :]

    # m products and their sum, where channels are mixed
    mixed = unit * (1 + len(block.inputs)) * (np.abs(block.into) @ block.error_limit) * block.mixes
    signals = [*mixed]
    states = np.zeros(block.n_states)

    # y = d v + x1: coefficient and product of d v, and the sum
    at = inputs.copy()
    i = 0
    for stage, output in zip(block.stages, outputs, strict=True):
        v = at[stage.channel]
        d, b1, b2, a1, a2 = np.abs(stage.coefficients)
        x1 = block.bound[i]
        signals.append(unit * (2 * d * v + output))

        # x1: b1 v - a1 x1 + x2;  x2: b2 v - a2 x1: at most four roundings of each term, and
        # the state's own sum of second order, for it is compensated
        rows = [
            (b1 * v, a1 * x1, block.bound[i + 1] if stage.order > 1 else 0.0),
            (b2 * v, a2 * x1),
        ]
        for j in range(stage.order):
            states[i + j] = unit * 4 * sum(rows[j]) + 4 * unit**2 * block.bound[i + j]
        at[stage.channel], i = output, i + stage.order

    # a state as read lacks what the compensation carries: 2 units of its bound
    by_signal, by_state, _ = _gains(block, np.array(signals), states, 2 * unit * block.bound, steps)
    asked = np.abs(block.out) @ _outputs(block)
    return by_signal + by_state + unit * (2 + len(block.into)) * asked


def word_errors(block: CascadeBlock, bits: int) -> float:
    """The error of the response with the sections' coefficients rounded to ``bits`` bits of
    mantissa.
    """
    stages = [
        replace(stage, coefficients=tuple(round_to_bits(np.array(stage.coefficients), bits)))
        for stage in block.stages
    ]
    law = _law(
        block,
        [stage.theta for stage in stages],
        round_to_bits(block.into, bits),
        round_to_bits(block.out, bits),
    )
    return response_error(sampled_response(*block_law(block)), sampled_response(*law), FLOOR)


def _inputs(block: CascadeBlock) -> np.ndarray:
    """The range (c,) [m] of every channel's input; without mixing the errors themselves."""
    return block.signals[: len(block.into)] if block.mixes else block.error_limit


def _outputs(block: CascadeBlock) -> np.ndarray:
    """The range (c,) [m] of what leaves every channel."""
    last = _inputs(block).copy()
    for stage, size in zip(block.stages, block.signals[len(block.into) :], strict=True):
        last[stage.channel] = size
    return last


def _section_rows(block: CascadeBlock) -> tuple[list[np.ndarray], list[str]]:
    """Every section's rows (3, 3) with signals and states in parts of their ranges, and its
    name.
    """
    at = _inputs(block).copy()
    rows = []
    i = 0
    for stage, size in zip(block.stages, block.signals[len(block.into) :], strict=True):
        # y/size, x/bound from v/range, x/bound
        own = block.bound[i : i + stage.order]
        theta = stage.theta * np.array([at[stage.channel], *own]) / np.array([size, *own])[:, None]
        rows.append(np.pad(theta, (0, 2 - stage.order)))
        at[stage.channel], i = size, i + stage.order
    return rows, [f"the section {stage.label}" for stage in block.stages]


def _state_rows(block: CascadeBlock, per_section: np.ndarray) -> np.ndarray:
    """(n,) of (s, 3): the rows that belong to states."""
    found = [per_section[k, 1 : 1 + stage.order] for k, stage in enumerate(block.stages)]
    return np.concatenate([*found, np.zeros(0)]).astype(int)


def _running_law(fixed: FixedCascade) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A - I, B, C and D of the whole-number coefficients, in the block's units."""
    block = fixed.block
    at = _inputs(fixed.block).copy()
    i = 0
    thetas = []
    tables = fixed.sections * np.exp2(-fixed.section_bits)[:, :, None]
    for stage, size, table in zip(
        block.stages, block.signals[len(block.into) :], tables, strict=True
    ):
        # back from parts of ranges: rows times the outputs' ranges, columns over the inputs'
        own = block.bound[i : i + stage.order]
        k = stage.order + 1
        thetas.append(
            table[:k, :k] * np.array([size, *own])[:, None] / np.array([at[stage.channel], *own])
        )
        at[stage.channel], i = size, i + stage.order
    into = (
        fixed.into
        * np.exp2(-fixed.into_bits)[:, None]
        * _inputs(block)[:, None]
        / block.error_limit
    )
    out = (
        fixed.output
        * np.exp2(-fixed.output_bits)[:, None]
        * block.current_limit[:, None]
        / _outputs(block)
    )
    return _law(block, thetas, into if block.mixes else block.into, out)


def _law(
    block: CascadeBlock, thetas: list[np.ndarray], into: np.ndarray, out: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    chains = [
        chain(1.0, [t for t, stage in zip(thetas, block.stages, strict=True) if stage.channel == c])
        for c in range(len(into))
    ]

    # bank: [[D, C], [B, A - I]]
    theta = bank(chains, into, out)
    m = len(block.inputs)
    p = len(block.outputs)
    return theta[p:, m:], theta[p:, :m], theta[:p, m:], theta[:p, :m]


def _rounding(fixed: FixedCascade) -> tuple[np.ndarray, np.ndarray]:
    """Bound and expected root mean square (p,) [A] of what rounding does to the currents, while
    none is limited.
    """
    block, half = fixed.block, 0.5 * 2.0**-fixed.signal_bits

    # half a unit of every signal's word: inputs of mixed channels are kept for the next sample
    # (saved), sections' outputs are not
    saved = half * _inputs(block) * block.mixes
    signals = np.concatenate([np.zeros(len(saved)), half * block.signals[len(saved) :]])

    # a state is rounded to a signal's word when read, and lacks the fraction that is saved
    reads = (half + 0.5 * 2.0**-fixed.state_bits) * block.bound
    by_signal, by_state, energy = _gains(
        block, signals, np.zeros(block.n_states), reads, HORIZON, saved
    )

    # rounding of the current itself
    own = half * block.current_limit
    # a uniform error within +-h has the variance h^2/3
    return by_signal + by_state + own, np.sqrt((energy + own**2) / 3)


def _gains(
    block: CascadeBlock,
    signals: np.ndarray,
    states: np.ndarray,
    reads: np.ndarray,
    steps: float,
    saved: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What errors do to the currents: bounds (p,) [A] by those of signals (c + s,) [m], of the
    states' increments and of their words together, and the energy (p,) of all, each taken as white.

    states (n,): added at every sample; reads (n,): made in reading a state. saved (c,): errors of
    the channels' inputs that are made good at the next sample: with H(z) (1 - 1/z) = D (1 - 1/z) +
    (C B + C (z - A)^-1 (A - I) B)/z no integrator sees them.
    """
    n = block.n_states
    p = len(block.outputs)
    count = len(block.into)
    B, D = _from_signals(block)
    E, C = block.increment, block.C

    # by source: how unit errors of its columns reach the states at the next sample, and the
    # currents at once
    sources = [
        (B * signals, D * signals),
        (np.diag(states), np.zeros((p, n))),
        (E * reads, C * reads),
    ]
    direct = [np.abs(item).sum(axis=1) for _, item in sources]
    if saved is not None:
        # saved errors: D at once, C B - D a sample later, then C (z - A)^-1 E B/z
        b, d = B[:, :count] * saved, D[:, :count] * saved
        sources.append((E @ b, C @ b - d))
        direct.append((np.abs(C @ b - d) + np.abs(d)).sum(axis=1))
    # of an unstable controller that somebody insists on
    with np.errstate(over="ignore", invalid="ignore"):
        bounds = [
            found + _peak(block, part, steps)
            for (part, _), found in zip(sources, direct, strict=True)
        ]
    bounds = [np.nan_to_num(item, nan=np.inf, posinf=np.inf) for item in bounds]
    if saved is None:
        return bounds[0], bounds[1] + bounds[2], np.zeros(p)

    # squares of what reaches the currents at once; x x^T: what all sources put into the states
    energy, x = (
        sum((item**2).sum(axis=1) for _, item in sources) + (d**2).sum(axis=1),
        np.hstack([s for s, _ in sources]),
    )

    # sum of A^k x x^T A^kT:  G_2N = G_N + A^N G_N A^NT
    power, gramian = E + np.eye(n), x @ x.T
    for _ in range(_DOUBLINGS):  # the gramian of the first 2, 4, 8 ... samples
        gramian, power = gramian + power @ gramian @ power.T, power @ power
    return (
        bounds[0] + bounds[3],
        bounds[1] + bounds[2],
        energy + np.maximum(((C @ gramian) * C).sum(axis=1), 0.0),
    )


def _peak(block: CascadeBlock, B: np.ndarray, steps: float) -> np.ndarray:
    """Bounds (p,) on C x for errors of +-1 through B (n, k), channel by channel."""
    total = np.zeros(len(block.outputs))
    for own in block_slices(block.sizes):
        # the columns that reach this channel's states
        used = B[own][:, np.abs(B[own]).max(axis=0, initial=0.0) > 0]
        k, p = own.stop - own.start, len(total)
        if used.size:
            # its states, then C x as states of one sample's memory, whose peak gain is that of C x
            whole = np.block(
                [[block.increment[own, own], np.zeros((k, p))], [block.C[:, own], -np.eye(p)]]
            )
            total += peak_gains(whole, np.vstack([used, np.zeros((p, used.shape[1]))]), steps)[
                k:
            ].sum(axis=1)
    return total


def _from_signals(block: CascadeBlock) -> tuple[np.ndarray, np.ndarray]:
    """How errors added to every channel's input and every section's output reach the states and
    currents: B (n, c + s), D.
    """
    count, n = len(block.into), block.n_states

    # at (c, c + s): errors in what every channel holds so far; a section's input errors reach its
    # states by b1, b2 and its output by d
    at = np.zeros((count, count + len(block.stages)))
    at[:, :count] = np.eye(count)
    B, i = np.zeros((n, at.shape[1])), 0
    for k, stage in enumerate(block.stages):
        d, b1, b2, _, _ = stage.coefficients
        B[i : i + stage.order] = np.outer([b1, b2][: stage.order], at[stage.channel])
        at[stage.channel] *= d
        at[stage.channel, count + k] = 1.0
        i += stage.order
    return B, block.out @ at
