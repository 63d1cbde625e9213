"""A filter bank as it stands in the machine file: c channels of second-order sections in series
between two constant mixings, from m errors e [m] to p currents u [A]; s sections, n states.

    v = into e                             every channel's signal [m]                       (1)
    y = d v + x1, v = y for the next one   every section of a channel; d, b1, b2, a1, a2 of its own
    x1 += b1 v - a1 x1 + x2
    x2 += b2 v - a2 x1
    u = out v                              the commanded current

That is the transposed direct form II in the operator delta = z - 1 in place of z. A slow pole keeps
its digits in any word and an integrator, a2 = 0, stays one, where the coefficients of z^-1 would
differ by rounding alone (Middleton & Goodwin 1990, ch. 10). Sections are sampled by Tustin's map,

    s = rate delta/(2 + delta),   rate = 2/dt, or w/tan(w dt/2) for exactness at w          (2)

Limits, anti-windup and transfer are those of the same law in modal form z (block/block.py), x = T z
in these states. With the slow modes bounded by the anti-windup, a signal row (e, x) is at most

    HEADROOM times the peak gain of the fast modes alone + |row T_slow| bound_slow          (3)

In whole numbers every signal is a part of its largest value, and no bit of an increment is lost.
Words, rows and sums are those of block/fixed_point.py, with a range for every channel's input,
section's output and state: its bound (3) (peak gains, Jackson 1970, with the anti-windup), so that
a section's row holds

    theta_ij range_j / range_i,   range_j of v, x1, x2, range_i of y, x1, x2                (4)

Signals saturate there all the same. What a shift cuts off a channel's input or a state's
increment is kept for the next sample (fraction saving), so that rounding never adds up in an
integrator: an error w of one sample that the next makes good reaches the currents by

    H(z) (1 - 1/z) = D (1 - 1/z) + (C B + C (z - A)^-1 (A - I) B)/z                         (5)

Two errors are told apart. Rounded coefficients are another law, compared by its response.
Rounding while it runs comes from known places: signals, and the words in which states are read;
each is followed to the currents by its peak gain (the bound) and by its energy (the noise
expected: independent errors within +-h of the variance h^2/3, h = 2^-s/2 of a range, for signals
that move by more than a bit),

    error = sum of h peak gain,   noise^2 = sum of h^2/3 sum_k |impulse response_k|^2        (6)

Tests by these numbers: tests/code/c/test_cascade.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    HEADROOM,
    HOLD_SAMPLES,
    WINDUP_TIME,
    ControlBlock,
    block_slices,
    check_settings,
    slow_states,
    state_bounds,
    transfer,
    unwinding,
)
from ambrose.code.block.fixed_point import (
    BITS,
    HORIZON,
    LARGEST_ERROR,
    Formats,
    WordLength,
    Words,
    floating_error,
    in_common,
    in_words,
    quantise_rows,
    response_error,
    round_to_bits,
    sampled_response,
    word_lengths,
)
from ambrose.code.sampled import Deployment
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.frequency import peak_gains
from ambrose.core.realisation import modal_form
from ambrose.core.statespace import StateSpace
from ambrose.law.pid import (
    axes_mixings,
    bank,
    chain,
    channel_chains,
    channel_names,
    mixings,
    section_matrix,
    section_text,
)
from ambrose.machine.machine import Machine
from ambrose.machine.part import PidSettings, Section

FLOOR = 0.1  # of the median gain: responses of sections are compared where there is some
_SAME = 1e-6  # of the response, how far sections may be from the controller that was verified


@dataclass(frozen=True, slots=True)
class Stage:
    """One section: its channel's number, its words for people, the coefficients d, b1, b2, a1 and
    a2 of (1), and its number of states, 1 or 2.
    """

    channel: int
    label: str
    coefficients: tuple[float, float, float, float, float]
    order: int

    @property
    def theta(self) -> np.ndarray:
        """[[D, C], [B, A - I]] (order + 1, order + 1): y and the steps of x1, x2 of v, x1, x2."""
        d, b1, b2, a1, a2 = self.coefficients
        whole = np.array([[d, 1.0, 0.0], [b1, -a1, 1.0], [b2, -a2, 0.0]])
        return whole[: self.order + 1, : self.order + 1]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CascadeBlock(ControlBlock):
    """(1) as it runs. States are in the unit of the errors, not in parts of their bound.

    into (c, m) [-], out (p, c) [A/m]; stages: channel by channel, the first next to the errors;
    bound (n,) [m]: largest states; signals (c + s,) [m]: largest inputs of the channels, then
    outputs of the sections; both by (3), for plausible errors and any limiting.
    """

    into: np.ndarray
    out: np.ndarray
    stages: tuple[Stage, ...]
    bound: np.ndarray
    signals: np.ndarray

    @property
    def state_range(self) -> np.ndarray:
        return self.bound

    @property
    def mixes(self) -> bool:
        """Whether channels are something else than the axes."""
        return not np.array_equal(self.into, np.eye(len(self.inputs)))

    @property
    def padding(self) -> tuple[int, int]:
        return 0, 0

    def said(self) -> dict[str, Any]:
        return {"cascade": True, "mixes": self.mixes, "channels": len(self.into)}

    def listing(self) -> Sequence[tuple[Stage, Sequence[float], float]]:
        rows = [stage.coefficients for stage in self.stages]
        return list(zip(self.stages, rows, self.signals[len(self.into) :], strict=True))

    def section_tables(self) -> dict[str, np.ndarray]:
        return {
            "into": self.into.T,
            "out": self.out.T,
            "channel": np.array([stage.channel for stage in self.stages], int),
            "order": np.array([stage.order for stage in self.stages], int),
        }

    def products(self, *, floating: bool) -> int:
        """Of a step: per state a and b, in whole numbers the factor between ranges as well; d of
        every section; out, and into where channels are mixed.
        """
        m, p = len(self.inputs), len(self.outputs)
        per_state = 2 if floating else 3
        return per_state * self.n_states + len(self.stages) + m * p + m * m * self.mixes

    @property
    def fractions(self) -> int:
        return self.n_states + len(self.inputs) * self.mixes

    def respond(self, e: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(1), section by section as the code computes: the commanded currents (p,) [A] and what is
        added to the states (n,) [m], from errors (m,) [m] and states.
        """
        # v (c,): input of every channel's next section; i: the section's first state
        v = self.into @ e
        step = np.empty(len(x))
        i = 0
        for stage in self.stages:
            d, b1, b2, a1, a2 = stage.coefficients
            v_in = v[stage.channel]
            step[i] = b1 * v_in - a1 * x[i]
            if stage.order > 1:
                step[i] += x[i + 1]
                step[i + 1] = b2 * v_in - a2 * x[i]
            v[stage.channel] = d * v_in + x[i]
            i += stage.order
        return self.out @ v, step


def build_cascade(
    deployment: Deployment,
    settings: PidSettings | None,
    machine: Machine | None,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    prewarp: float | None = None,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
) -> CascadeBlock:
    """The filters of ``settings`` as the block of a deployment, sampled by Tustin's map, which is
    exact at ``prewarp`` [rad/s].

    machine: for channels that are not the axes. The rest as in ``build_block``. Raises InvalidInput
    for a controller that has no filters, or others than those, and UnstableSystem for states
    without a bound.
    """
    K = deployment.controller
    checked = check_settings(K, name, error_limit, current_limit, windup_time, hold_samples)
    if settings is None:
        raise InvalidInput(
            "a cascade needs a bank of filters, and this controller is not one; design one "
            "(--method pid, or tuned with "
            "--structure pid or filters), or use the modal form"
        )
    if deployment.method != "tustin" or deployment.source.dt is not None:
        raise InvalidInput(
            "sections keep their names by Tustin's map alone; use --sampling tustin, or the modal "
            "form"
        )

    # mixings between axes and channels
    axes = tuple(item.removeprefix("err_") for item in K.inputs)
    if machine is None and settings.coordinates != "axes":
        raise InvalidInput(
            "the machine is not known, whose bearings and sensors mix the channels; name its "
            "file, --machine my.toml"
        )
    mixed = None if machine is None else mixings(settings, machine)
    into, out = axes_mixings(settings, axes, mixed)
    dt = float(K.dt or 0.0)

    # (2): (z - 1)/(z + 1) = j tan(w dt/2) at z = exp(j w dt)
    rate = 2 / dt if prewarp is None else prewarp / np.tan(prewarp * dt / 2)
    stages, chains = list[Stage](), list[np.ndarray]()
    for c, (label, (gain, sections)) in enumerate(
        zip(channel_names(settings, axes), channel_chains(settings, axes), strict=True)
    ):
        # sections with states are stages; constant ones and the channel's gain go into its
        # column of out
        sampled = [
            _stage(c, f"{label}: {section.kind}, {section_text(section)}", section, rate)
            for section in sections
        ]
        with_states = [stage for stage in sampled if stage.order]
        out = out * np.where(np.arange(len(into)) == c, gain * _constant(sections), 1.0)
        chains.append(chain(1.0, [stage.theta for stage in with_states]))
        stages += with_states

    # [[D, C], [B, A - I]] of the whole bank, outputs (p) and inputs (m) first
    theta = bank(chains, into, out)
    m = len(K.inputs)
    p = len(K.outputs)
    D = theta[:p, :m]
    C = theta[:p, m:]
    B = theta[p:, :m]
    E = theta[p:, m:]

    # what runs must be what was verified, by its response
    law, exact = sampled_response(E, B, C, D), sampled_response(deployment.increment, K.B, K.C, K.D)
    if not response_error(exact, law, FLOOR) <= _SAME:
        raise InvalidInput(
            "the controller is not the one that its filters give on this machine, so that the "
            "verified controller would not run; "
            + (
                "name its file, --machine my.toml, "
                if machine is None
                else "design it again (without --loss), "
            )
            + "or use the modal form"
        )

    # limits, anti-windup and transfer follow in _guarded; empty until then
    block = ControlBlock(
        name=name,
        inputs=K.inputs,
        outputs=K.outputs,
        sample_time=dt,
        delay=deployment.delay,
        increment=E,
        B=B,
        C=C,
        D=D,
        sizes=tuple(len(item) - 1 for item in chains if len(item) > 1),
        unwind=np.zeros((len(E), p)),
        winding=len(E),
        from_error=np.zeros((len(E), m)),
        from_output=np.zeros((len(E), p)),
        error_limit=checked.error_limit,
        current_limit=checked.current_limit,
        raw_limit=checked.current_limit,
        hold_samples=hold_samples,
        windup_time=windup_time,
    )
    return _guarded(deployment, block, into, out, tuple(stages))


def _stage(channel: int, label: str, section: Section, rate: float) -> Stage:
    """A section sampled by (2), rate [1/s]; a constant has no state."""
    theta = section_matrix(section)
    D = theta[0, 0]
    C = theta[0, 1:]
    B = theta[1:, 0]
    A = theta[1:, 1:]
    order = len(A)
    if order == 0:
        return Stage(channel, label, (float(D), 0.0, 0.0, 0.0, 0.0), 0)
    if order == 1:
        # D + C B/(s - A) = (D (s - A) + C B)/(s - A); rows: coefficients of s^2, s, 1
        below = np.array([0.0, 1.0, -A[0, 0]])
        above = D * below + [0.0, 0.0, C[0] * B[0]]
    else:
        # below = det(s - A) = s^2 - tr A s + det A; above = D below + C adj(s - A) B,
        # C adj(s - A) B = C B s + straight
        below = np.array([1.0, -A[0, 0] - A[1, 1], A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]])
        straight = C[0] * (A[0, 1] * B[1] - A[1, 1] * B[0]) + C[1] * (
            A[1, 0] * B[0] - A[0, 0] * B[1]
        )
        above = D * below + [0.0, C @ B, straight]
    # of delta: s^2, s, 1 times (2 + delta)^2
    powers = np.array([[rate**2, 0.0, 0.0], [rate, 2 * rate, 0.0], [1.0, 4.0, 4.0]])
    if order == 1:
        powers = np.array([[0.0, 0.0, 0.0], [rate, 0.0, 0.0], [1.0, 2.0, 0.0]])  # times 2 + delta

    # columns: the highest power of delta first, so that lead is that of the denominator
    (n2, n1, n0), (lead, a1, a2) = above @ powers, below @ powers

    # n/(delta^2 + a1 delta + a2) = d + (b1 delta + b2)/(...), b = n - a d
    d = n2 / lead
    a1 = a1 / lead
    a2 = a2 / lead
    return Stage(channel, label, (d, n1 / lead - a1 * d, n0 / lead - a2 * d, a1, a2), order)


def _constant(sections: Sequence[Section]) -> float:
    """The product of the sections that have no state."""
    parts = [section_matrix(section) for section in sections]
    return float(np.prod([part[0, 0] for part in parts if len(part) == 1]))


def _guarded(
    deployment: Deployment,
    block: ControlBlock,
    into: np.ndarray,
    out: np.ndarray,
    stages: tuple[Stage, ...],
) -> CascadeBlock:
    """The law with anti-windup and transfer as in modal form, and the bounds (3). into (c, m), out
    (p, c).
    """
    n = block.n_states
    m = len(block.inputs)
    errors = block.error_limit
    currents = block.current_limit

    # modal form with the cascade's states x as outputs beside the currents
    whole = StateSpace(
        block.increment,
        block.B,
        np.vstack([block.C, np.eye(n)]),
        np.vstack([block.D, np.zeros((n, m))]),
    )
    form = modal_form(whole)
    A = form.system.A
    B = form.system.B
    C = form.system.C[: len(out)]
    T = form.system.C[len(out) :]

    # what the transform leaves outside the blocks is rounding
    inside = np.zeros((n, n), bool)
    for start, k in zip(form.starts, form.sizes, strict=True):
        inside[start : start + k, start : start + k] = True
    A = np.where(inside, A, 0.0)
    K = StateSpace(A + np.eye(n), B, C, block.D, block.inputs, block.outputs, block.sample_time)
    modal = replace(deployment, controller=K, increment=A, sizes=form.sizes)

    # anti-windup, bounds and transfer of the modal law, states unscaled
    slow = slow_states(A, form.sizes, block.sample_time, block.windup_time)
    settings = check_settings(
        K, block.name, errors, currents, block.windup_time, block.hold_samples
    )
    gain = unwinding(modal, slow, currents, block.sample_time / block.windup_time)
    bound = state_bounds(modal, gain, slow, settings)
    from_error, from_output = transfer(modal, np.ones(n), slow, currents)
    # A of the fast modes in the states x; slow ones, of which (3) takes the bound, end at once
    decaying = (
        T @ np.where(slow[:, None] | slow, -np.eye(n) * slow, A) @ np.linalg.inv(T) if n else A
    )

    # rows (c + s + p, m + n): signals and commanded currents, from errors and states
    rows = _signal_rows(block, into, stages)
    rows = np.vstack([rows, np.hstack([block.D, block.C])])

    # fast modes alone: states x, then the rows as states of one sample's memory, whose next value
    # is row (e, x), so that its peak gain is that of the signal
    driven = np.where(slow[:, None], 0.0, B)
    fast = peak_gains(
        np.block(
            [
                [decaying, np.zeros((n, len(rows)))],
                [rows[:, m:] @ T @ (~slow[:, None] * np.linalg.inv(T)), -np.eye(len(rows))],
            ]
        ),
        np.vstack([T @ driven, rows[:, :m]]) * errors,
    ).sum(axis=1)

    # (3) of the rows, and below of the states themselves
    signals = HEADROOM * fast[n:] + np.abs(rows[:, m:] @ T[:, slow]) @ bound[slow]
    signals = np.maximum(signals, np.finfo(float).tiny)
    kept = {item.name: getattr(block, item.name) for item in fields(block)}
    kept |= {
        "unwind": T @ gain,
        "from_error": T @ from_error,
        "from_output": T @ from_output,
        "raw_limit": np.maximum(signals[len(rows) - len(out) :], currents),
    }
    return CascadeBlock(
        **kept,
        into=into,
        out=out,
        stages=stages,
        bound=np.maximum(
            HEADROOM * fast[:n] + np.abs(T[:, slow]) @ bound[slow], np.finfo(float).tiny
        ),
        signals=signals[: len(rows) - len(out)],
    )


def _signal_rows(block: ControlBlock, into: np.ndarray, stages: Sequence[Stage]) -> np.ndarray:
    """Every channel's input, then every section's output, as rows of errors and states (c + s, m +
    n).
    """
    # at (c, m + n): the signal that every channel has come to; y = d v + x1 after each section
    at = np.hstack([into, np.zeros((len(into), block.n_states))])
    rows, i = [*at.copy()], 0
    for stage in stages:
        at[stage.channel] *= stage.coefficients[0]
        at[stage.channel, len(block.inputs) + i] += 1.0
        rows.append(at[stage.channel].copy())
        i += stage.order
    return np.array(rows)


# of the response by rounded coefficients, a tenth of a decibel; where the response is below a tenth
# of its median gain, of that tenth
LARGEST_GAIN_ERROR = 0.01
_DOUBLINGS = 13  # 8192 samples of the impulse responses, whose energy gives the noise


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixedCascade(Words):
    """Whole-number coefficients; true ones, (4), are these times 2^-bits of their row. sections (s,
    3, 3), section_bits (s, 3): rows y, x1, x2 of v, x1, x2; into (c, m), into_bits (c,); output (p,
    c): of the channels' last signals; noise (p,) [A]: root mean square of (6); gain_error [-]: of
    the response, by rounded coefficients.
    """

    block: CascadeBlock
    into: np.ndarray
    into_bits: np.ndarray
    sections: np.ndarray
    section_bits: np.ndarray
    noise: np.ndarray = field(default_factory=lambda: np.zeros(0))
    gain_error: float = 0.0

    def said(self) -> dict[str, Any]:
        noise = ", ".join(f"{value:.2g}" for value in self.noise)
        return self.block.said() | {"noise": noise, "gain_error": f"{self.gain_error:.2g}"}

    def listing(self) -> Sequence[tuple[Stage, Sequence[float], float]]:
        rows = self.sections.reshape(-1, 9)[:, [0, 1, 3, 4, 5, 6, 7]]
        return [
            (stage, row, largest)
            for (stage, _, largest), row in zip(self.block.listing(), rows, strict=True)
        ]

    def section_tables(self) -> dict[str, np.ndarray]:
        return {
            **self.block.section_tables(),
            "into": self.into.T,
            "out": self.output.T,
            "row_bits": self.section_bits[:, 0],
            "into_bits": self.into_bits,
        }

    def formats(self) -> Formats:
        stages = self.block.stages
        names = [
            f"{stage.label}, {row}"
            for stage in stages
            for row in ("y", "x1", "x2")[: stage.order + 1]
        ]
        used = [k for stage in stages for k in [True, True, stage.order > 1]]
        bits = self.section_bits.ravel()[used]
        return [(names, self.sections.reshape(-1, 3)[used], bits), *Words.formats(self)]


@in_words.register
def _(block: CascadeBlock, word: int = 32, largest_error: float = LARGEST_ERROR) -> FixedCascade:
    errors = block.error_limit
    currents = block.current_limit
    channels = _inputs(block)

    # (4): channels' inputs of errors, both in parts of their ranges; then the sections' rows
    into, into_bits = quantise_rows(
        block.into * errors / channels[:, None], word, "a channel's input"
    )
    rows, names = _section_rows(block)
    quantised = [quantise_rows(item, word, name) for item, name in zip(rows, names, strict=True)]
    sections = np.array([table for table, _ in quantised], np.int64).reshape(-1, 3, 3)
    section_bits = np.array([bits for _, bits in quantised], int).reshape(-1, 3)

    # currents from the channels' last signals
    output = block.out * _outputs(block) / currents[:, None]
    state_bits = _state_rows(block, section_bits)
    fixed = FixedCascade(
        into=into,
        into_bits=into_bits,
        sections=sections,
        section_bits=section_bits,
        **in_common(block, word, state_bits, output),
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
            f"{block.raw_limit[worst] / currents[worst]:.3g} times the limit is commanded at "
            f"the largest error: lower error_limit to {narrow:.1g} m, reduce the gain at high "
            "frequencies, or use words of "
            "32 bits or floating point",
        )
    return replace(fixed, error=error, noise=noise, gain_error=moved)


def block_law(block: CascadeBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A - I (n, n), B (n, m), C (p, n) and D (p, m), from errors [m] to currents [A]."""
    return block.increment, block.B, block.C, block.D


@floating_error.register
def _(block: CascadeBlock, bits: int, steps: float = HORIZON) -> np.ndarray:
    # half a unit of the mantissa per operation, relative to the operand's bound; followed as in (6)
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
    commanded = np.abs(block.out) @ _outputs(block)
    return by_signal + by_state + unit * (2 + len(block.into)) * commanded


@word_lengths.register
def _(block: CascadeBlock, bits: tuple[int, ...] = BITS) -> tuple[WordLength, ...]:
    return tuple(WordLength(count, _rounded_error(block, count), np.nan) for count in bits)


def _rounded_error(block: CascadeBlock, bits: int) -> float:
    """The error [-] of the response with all coefficients rounded to ``bits`` bits of mantissa."""
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
    """The rows (4) of every section, (3, 3), and its name."""
    at = _inputs(block).copy()
    rows = []
    i = 0
    for stage, size in zip(block.stages, block.signals[len(block.into) :], strict=True):
        bound = block.bound[i : i + stage.order]
        ranges_in, ranges_out = np.array([at[stage.channel], *bound]), np.array([size, *bound])
        theta = stage.theta * ranges_in / ranges_out[:, None]
        rows.append(np.pad(theta, (0, 2 - stage.order)))
        at[stage.channel], i = size, i + stage.order
    return rows, [f"the section {stage.label}" for stage in block.stages]


def _state_rows(block: CascadeBlock, per_section: np.ndarray) -> np.ndarray:
    """Entries (n,) of (s, 3) that belong to states: x1 and, of second order, x2."""
    rows = [per_section[k, 1 : 1 + stage.order] for k, stage in enumerate(block.stages)]
    return np.concatenate([*rows, np.zeros(0)]).astype(int)


def _running_law(fixed: FixedCascade) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """As ``block_law``, of the whole-number coefficients: (4) undone."""
    block = fixed.block
    at = _inputs(fixed.block).copy()
    i = 0
    thetas = []
    tables = fixed.sections * np.exp2(-fixed.section_bits)[:, :, None]
    for stage, size, table in zip(
        block.stages, block.signals[len(block.into) :], tables, strict=True
    ):
        bound = block.bound[i : i + stage.order]
        ranges_in, ranges_out = np.array([at[stage.channel], *bound]), np.array([size, *bound])
        k = stage.order + 1
        thetas.append(table[:k, :k] * ranges_out[:, None] / ranges_in)
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
    """As ``block_law``, of sections ``thetas``, one per stage, between the mixings."""
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
    """(6): bound and expected root mean square (p,) [A] of what rounding does to the currents,
    while none is limited.
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
    last = half * block.current_limit
    return by_signal + by_state + last, np.sqrt((energy + last**2) / 3)


def _gains(
    block: CascadeBlock,
    signals: np.ndarray,
    states: np.ndarray,
    reads: np.ndarray,
    steps: float,
    saved: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What errors do to the currents while it runs: bounds (p,) [A] by those of signals, and by
    those of states; energy (p,) [A^2]: sum of squared impulse responses of all, where ``saved`` is
    given.

    Errors of every sample, at most: signals (c + s,) [m]; states (n,) [m]: of the increments; reads
    (n,) [m]: in reading a state; saved (c,) [m]: of the channels' inputs, made good at the next
    sample: by (5) no integrator sees them. steps: samples that the bounds hold for.
    """
    n = block.n_states
    p = len(block.outputs)
    count = len(block.into)
    B, D = _from_signals(block)
    E, C = block.increment, block.C

    # by source: its errors' effect on the states at the next sample, and on the currents at once;
    # an error w in reading x adds E w to the step and C w to the currents
    sources = [
        (B * signals, D * signals),
        (np.diag(states), np.zeros((p, n))),
        (E * reads, C * reads),
    ]
    direct = [np.abs(item).sum(axis=1) for _, item in sources]
    if saved is not None:
        # (5): D at once, C B - D a sample later, then C (z - A)^-1 E B/z
        b, d = B[:, :count] * saved, D[:, :count] * saved
        sources.append((E @ b, C @ b - d))
        direct.append((np.abs(C @ b - d) + np.abs(d)).sum(axis=1))
    # of an unstable controller that somebody insists on
    with np.errstate(over="ignore", invalid="ignore"):
        bounds = [
            at_once + _peak(block, to_states, steps)
            for (to_states, _), at_once in zip(sources, direct, strict=True)
        ]
    bounds = [np.nan_to_num(item, nan=np.inf, posinf=np.inf) for item in bounds]
    if saved is None:
        return bounds[0], bounds[1] + bounds[2], np.zeros(p)

    # squares of what reaches the currents at once; x: all columns that reach the states
    energy, x = (
        sum((item**2).sum(axis=1) for _, item in sources) + (d**2).sum(axis=1),
        np.hstack([s for s, _ in sources]),
    )

    # gramian G = sum of A^k x x^T A^kT, by doubling: G_2N = G_N + A^N G_N A^NT; C G C^T is the rest
    power, gramian = E + np.eye(n), x @ x.T
    for _ in range(_DOUBLINGS):  # the gramian of the first 2, 4, 8 ... samples
        gramian, power = gramian + power @ gramian @ power.T, power @ power
    return (
        bounds[0] + bounds[3],
        bounds[1] + bounds[2],
        energy + np.maximum(((C @ gramian) * C).sum(axis=1), 0.0),
    )


def _peak(block: CascadeBlock, B: np.ndarray, steps: float) -> np.ndarray:
    """Bounds (p,) [A] on C x within ``steps`` samples, for errors of +-1 in every sample through B
    (n, k), channel by channel.
    """
    total = np.zeros(len(block.outputs))
    for states in block_slices(block.sizes):
        # the columns that reach this channel's states
        used = B[states][:, np.abs(B[states]).max(axis=0, initial=0.0) > 0]
        k, p = states.stop - states.start, len(total)
        if used.size:
            # its states, then C x as states of one sample's memory, whose peak gain is that of C x
            whole = np.block(
                [
                    [block.increment[states, states], np.zeros((k, p))],
                    [block.C[:, states], -np.eye(p)],
                ]
            )
            total += peak_gains(whole, np.vstack([used, np.zeros((p, used.shape[1]))]), steps)[
                k:
            ].sum(axis=1)
    return total


def _from_signals(block: CascadeBlock) -> tuple[np.ndarray, np.ndarray]:
    """How errors added to every channel's input and every section's output reach the states, B (n,
    c + s), and the currents, D (p, c + s) [A/m].
    """
    count, n = len(block.into), block.n_states

    # at (c, c + s): errors in the signal that every channel has come to; those of a section's input
    # reach its states by b1, b2 and its output by d
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
