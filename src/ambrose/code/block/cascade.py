"""A filter bank as it stands in the machine file: channels of second-order sections in series
between two constant mixings.

    v = into e                             every channel's signal [m]
    y = d v + x1, v = y for the next one   every section of a channel; d, b1, b2, a1, a2 of its own
    x1 += b1 v - a1 x1 + x2
    x2 += b2 v - a2 x1
    u = out v                              the current asked for

That is the transposed direct form II in the operator z - 1 in place of z. A slow pole keeps its
digits in any word and an integrator, a2 = 0, stays one, where the coefficients of z^-1 would differ
by rounding alone (Middleton & Goodwin 1990, ch. 10). Limits, anti-windup and transfer are those of
the same law in modal form (block/fixed.py), brought into these states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    HEADROOM,
    HOLD_SAMPLES,
    WINDUP_TIME,
    check_settings,
    slow_states,
)
from ambrose.code.block.fixed import ControlBlock, state_bounds, transfer, unwinding
from ambrose.code.block.word_length import response_error, sampled_response
from ambrose.code.sampled import Deployment
from ambrose.core.checks import InvalidInput
from ambrose.core.peak_gain import peak_gains
from ambrose.core.realisation.modal_form import modal_form
from ambrose.core.statespace import StateSpace
from ambrose.law.filters import bank, chain, section_matrix, section_text
from ambrose.law.pid import axes_mixings, channel_chains, channel_names, mixings
from ambrose.machine.controller import PidSettings, Section
from ambrose.machine.machine import Machine

FLOOR = 0.1  # of the median gain: responses of sections are compared where there is some
_SAME = 1e-6  # of the response, how far sections may be from the controller that was verified


@dataclass(frozen=True, slots=True)
class Stage:
    """One section: its channel's number, what it is, d, b1, b2, a1 and a2, and how many states it
    has (1 or 2).
    """

    channel: int
    label: str
    coefficients: tuple[float, float, float, float, float]
    order: int

    @property
    def theta(self) -> np.ndarray:
        """[[D, C], [B, A - I]] (order + 1, order + 1)."""
        # (y, x1 step, x2 step) from (v, x1, x2)
        d, b1, b2, a1, a2 = self.coefficients
        whole = np.array([[d, 1.0, 0.0], [b1, -a1, 1.0], [b2, -a2, 0.0]])
        return whole[: self.order + 1, : self.order + 1]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CascadeBlock(ControlBlock):
    """What runs: see the module's formulas. States are in the unit of the errors, not in parts of
    their bound.

    into (c, m) [-], out (p, c) [A/m]; stages: channel by channel, the first next to the errors;
    bound (n,) [m] of the states and signals (c + s,) [m]: of the channels' inputs, then of the
    sections' outputs, for plausible inputs and any limiting.
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

    def respond(self, e: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The currents asked for (p,) [A] and what is added to the states (n,), section by section
        as the code computes.
        """
        # v (c,): what every channel's next section is given; i: the section's first state
        v = self.into @ e
        step = np.empty(len(x))
        i = 0
        for stage in self.stages:
            d, b1, b2, a1, a2 = stage.coefficients
            given = v[stage.channel]
            step[i] = b1 * given - a1 * x[i]
            if stage.order > 1:
                step[i] += x[i + 1]
                step[i + 1] = b2 * given - a2 * x[i]
            v[stage.channel] = d * given + x[i]
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
            "this controller is no bank of filters, whose sections a cascade needs; design one "
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

    # s = rate (z - 1)/(z + 1) with (z - 1)/(z + 1) = j tan(w dt/2) at z = exp(j w dt):
    # exact at prewarp
    rate = 2 / dt if prewarp is None else prewarp / np.tan(prewarp * dt / 2)
    stages, chains = list[Stage](), list[np.ndarray]()
    for c, (label, (gain, sections)) in enumerate(
        zip(channel_names(settings, axes), channel_chains(settings, axes), strict=True)
    ):
        # sections with states are stages; constant ones and the channel's gain go into its
        # column of out
        own = [
            _stage(c, f"{label}: {section.kind}, {section_text(section)}", section, rate)
            for section in sections
        ]
        own = [stage for stage in own if stage.order] or []
        out = out * np.where(np.arange(len(into)) == c, gain * _constant(sections), 1.0)
        chains.append(chain(1.0, [stage.theta for stage in own]))
        stages += own

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
            "the controller is not the one that its filters give on this machine, so that what "
            "was verified would not run; "
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
    """A section sampled by s = rate delta/(2 + delta), delta = z - 1; a constant has no state."""
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
    """The law with anti-windup and transfer as in modal form, and the bounds that follow."""
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
    # x = T z
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
    # x = what the slow modes, bounded by the anti-windup, add to the response of the fast ones
    # alone
    decaying = (
        T @ np.where(slow[:, None] | slow, -np.eye(n) * slow, A) @ np.linalg.inv(T) if n else A
    )

    # part of the slow modes: |T_slow| bound_slow
    share = np.abs(T[:, slow]) @ bound[slow]

    # signals (c + s) and currents asked for (p), from errors (m) and states (n)
    rows = _signal_rows(block, into, stages)
    rows = np.vstack([rows, np.hstack([block.D, block.C])])

    # fast modes alone, slow ones of A set to zero: states x, then the rows as states of one
    # sample's memory, whose next value is row (e, x): its peak gain is that of the signal
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

    # bound of each signal: fast modes' peak, and the slow modes through its row
    signals = HEADROOM * fast[n:] + np.abs(rows[:, m:] @ T[:, slow]) @ bound[slow]
    signals = np.maximum(signals, np.finfo(float).tiny)
    kept = {key: getattr(block, key) for key in ControlBlock.__dataclass_fields__}
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
        bound=np.maximum(HEADROOM * fast[:n] + share, np.finfo(float).tiny),
        signals=signals[: len(rows) - len(out)],
    )


def _signal_rows(block: ControlBlock, into: np.ndarray, stages: Sequence[Stage]) -> np.ndarray:
    """Every channel's input, then every section's output, from errors and states: (c + s, m +
    n).
    """
    # at (c, m + n): what every channel holds so far; y = d v + x1 after each section
    at = np.hstack([into, np.zeros((len(into), block.n_states))])
    rows, i = [*at.copy()], 0
    for stage in stages:
        at[stage.channel] *= stage.coefficients[0]
        at[stage.channel, len(block.inputs) + i] += 1.0
        rows.append(at[stage.channel].copy())
        i += stage.order
    return np.array(rows)
