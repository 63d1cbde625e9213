"""Uncertainty blocks, generalized plants and linear fractional transformations; the loop diagram.

THE loop diagram. Quote it wherever a sign matters::

                          e  excitation [A]              f  force on the rotor [N]
                          |                              |
      r  +     e_y  +---+ u  v  + +-----------+  i       v  +-------+ q
     --->o--------->| K |------>o-| amplifier |--------->o->| rotor |---+--->  compliance: f -> q
        -^          +---+         +-----------+    k_i      +-------+   |
         |                                                              v
         |   y                         + d  output disturbance [m]  +--------+
         +--------------------------------------o<------------------| sensor |
                                                                    +--------+

    e_y = r - y          the control error [m]          u = K e_y      the controller's output [A]
    v   = u + e          what the amplifier receives    y = G v + d    the measured displacement [m]

    S_o = (I + G K)^-1   output sensitivity, d -> y      T_o = I - S_o
    S_i = (I + K G)^-1   input sensitivity,  e -> v      K S_o  control sensitivity, r -> u

A generalized plant is the same loop pulled apart: z = P11 w + P12 u, y = P21 w + P22 u, closed by u
= K y; since its measured output is the error e_y, the minus sign sits inside P. The uncertainty
closes the leading w and z: w = Delta z.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import (
    InvalidInput,
    check_finite,
    check_shape,
    invalid,
    memberwise,
    named_failure,
    names_wrong_types,
)
from ambrose.core.presentation import Presented, to_plain
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    append,
    as_statespace,
    check_loop,
    close,
    match_signals,
    poles,
    rename,
    select,
)

_PER_DECADE = 9  # points of a grid
# a design's grid reaches this factor beyond the slowest and fastest pole of the plant
_MARGIN = 10.0
_SAME = 1e-12  # of a column, to which it must be made of others
_FEW = 4  # channels up to which elimination side by side is faster than LAPACK point by point
_SMALL = 1e-5  # a pivot, over the other entries of its column, that spoils digits


@dataclass(frozen=True, slots=True)
class _ScalarBlock:
    """delta I_repeat; abstract. real, full: whether delta is real, and Delta any matrix."""

    real: ClassVar[bool] = False
    full: ClassVar[bool] = False
    name: str
    repeat: int = 1

    def __post_init__(self) -> None:
        _check_count(self.repeat, f"repeat of block {self.name!r}")

    @property
    def n_w(self) -> int:
        return self.repeat

    @property
    def n_z(self) -> int:
        return self.repeat


@dataclass(frozen=True, slots=True)
class RealBlock(_ScalarBlock):
    """delta I_repeat with -1 <= delta <= 1, real: one physical parameter."""

    real: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class ComplexBlock(_ScalarBlock):
    """delta I_repeat with |delta| <= 1, complex: unmodelled dynamics in one channel, possibly
    repeated.
    """


@dataclass(frozen=True, slots=True)
class FullBlock:
    """A full complex matrix Delta (n_w, n_z) with largest singular value at most 1, w = Delta z:
    performance, or dynamics.
    """

    real: ClassVar[bool] = False
    full: ClassVar[bool] = True
    repeat: ClassVar[int] = 1
    name: str
    n_w: int
    n_z: int

    def __post_init__(self) -> None:
        _check_count(self.n_w, f"n_w of block {self.name!r}")
        _check_count(self.n_z, f"n_z of block {self.name!r}")


Block = RealBlock | ComplexBlock | FullBlock


def _check_count(value: int, name: str) -> None:
    if not isinstance(value, int | np.integer) or value < 1:
        raise invalid(
            name, repr(value), "a whole number, at least 1", "leave the block out if it is empty"
        )


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class GeneralizedPlant(Presented):
    """A StateSpace with its signals parted: disturbances w, controls u, performance outputs z,
    measurements y.

    ``blocks`` is the uncertainty; its inputs are the leading ``w`` and its outputs the leading
    ``z``. The system is stored with inputs in the order (w, u) and outputs (z, y). Raises
    InvalidInput for unknown, repeated or missing signals.
    """

    system: StateSpace
    w: tuple[str, ...]
    u: tuple[str, ...]
    z: tuple[str, ...]
    y: tuple[str, ...]
    blocks: tuple[Block, ...]

    @names_wrong_types
    def __init__(
        self,
        system: Any,
        w: Sequence[str],
        u: Sequence[str],
        z: Sequence[str],
        y: Sequence[str],
        blocks: Sequence[Block] = (),
    ) -> None:
        groups = {
            side: (s,) if isinstance(s, str) else tuple(s)
            for side, s in zip("wuzy", (w, u, z, y), strict=True)
        }
        blocks = tuple(blocks)
        for count, side in ((sum(b.n_w for b in blocks), "w"), (sum(b.n_z for b in blocks), "z")):
            if count > len(groups[side]):
                raise invalid(
                    f"the blocks' {side} count",
                    count,
                    f"at most {len(groups[side])}",
                    f"list their signals first in {side}",
                )
        names = [b.name for b in blocks]
        if len(set(names)) != len(names):
            raise invalid(
                "the block names",
                names,
                "unique",
                "one block per parameter; use repeat for repeated ones",
            )
        object.__setattr__(
            self, "system", select(system, groups["w"] + groups["u"], groups["z"] + groups["y"])
        )
        for side, signals in groups.items():
            object.__setattr__(self, side, signals)
        object.__setattr__(self, "blocks", blocks)

    def facts(self) -> Mapping[str, Any]:
        """Its size and its uncertainty."""
        counts = {f"n_{side}": len(getattr(self, side)) for side in "wuzy"}
        return {
            "states": self.system.n_states,
            **counts,
            "blocks": [block.name for block in self.blocks],
        }

    def to_dict(self) -> dict[str, Any]:
        """The system, its signals and its blocks, ready for JSON."""
        signals = {side: list(getattr(self, side)) for side in "wuzy"}
        blocks = [{"kind": type(block).__name__, **asdict(block)} for block in self.blocks]
        return {"system": self.system.to_dict(), **signals, "blocks": to_plain(blocks)}

    @property
    def n_w_blocks(self) -> int:
        return sum(block.n_w for block in self.blocks)

    @property
    def n_z_blocks(self) -> int:
        return sum(block.n_z for block in self.blocks)


def lft(plant: GeneralizedPlant, controller: ControllerLike) -> StateSpace:
    """The lower LFT F_l(P, K): from w to z with u = K y closed. The controller's signals (y in, u
    out) are matched by name where it has the plant's names, else by place. Raises NumericalFailure
    for an algebraic loop without a solution.
    """
    controller = as_statespace(controller)
    if controller.D.shape != (len(plant.u), len(plant.y)):
        raise invalid(
            "the controller's size (outputs, inputs)",
            controller.D.shape,
            str((len(plant.u), len(plant.y))),
            "match u and y",
        )
    controller = match_signals(controller, plant.y, plant.u)
    inner = rename(controller, [f"from {y}" for y in plant.y], [f"to {u}" for u in plant.u])
    joined = append(plant.system, inner)

    # Both systems side by side; u gets the controller's outputs, its inputs get y.
    loop = np.zeros((len(joined.inputs), len(joined.outputs)))
    for u in plant.u:
        loop[joined.inputs.index(u), joined.outputs.index(f"to {u}")] = 1.0
    for y in plant.y:
        loop[joined.inputs.index(f"from {y}"), joined.outputs.index(y)] = 1.0
    return select(close(joined, loop), plant.w, plant.z)


def close_uncertainty(
    plant: GeneralizedPlant, delta: Mapping[str, float | np.ndarray]
) -> StateSpace:
    """The upper LFT F_u(P, Delta): each block closed with a number (or a matrix for a full block);
    absent blocks are zero.

    Returns the system from the remaining w and u to the remaining z and y.
    """
    unknown = set(delta) - {block.name for block in plant.blocks}
    if unknown:
        raise InvalidInput(
            f"block {sorted(unknown)[0]!r} is unknown; the plant has "
            f"{', '.join(b.name for b in plant.blocks)}"
        )

    # Delta (w, z), block-diagonal: i and j run down the blocks' w and z.
    gain = np.zeros((plant.n_w_blocks, plant.n_z_blocks))
    i = j = 0
    for block in plant.blocks:
        value = check_finite(delta.get(block.name, 0.0), f"delta of {block.name}")
        if np.iscomplexobj(value):
            raise invalid(
                f"delta of {block.name}",
                value,
                "real",
                "a real state space cannot hold a complex perturbation",
            )
        if not value.ndim:
            value = value * np.eye(block.n_w, block.n_z)
        elif not block.full:
            raise invalid(
                f"delta of {block.name}", value.tolist(), "one number", "it multiplies the identity"
            )
        check_shape(value, f"delta of {block.name}", "(w, z)", w=block.n_w, z=block.n_z)
        gain[i : i + block.n_w, j : j + block.n_z] = value
        i, j = i + block.n_w, j + block.n_z
    rest = plant.system.inputs[plant.n_w_blocks :], plant.system.outputs[plant.n_z_blocks :]
    return StateSpace(*upper_lft(plant.system, gain), *rest, plant.system.dt)


@named_failure("the closed loop")
def upper_lft(
    system: StateSpace, gain: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A (..., n, n), B (..., n, m), C (..., p, n) and D (..., p, m) of the system with w = gain z
    closed: its leading inputs w and outputs z, for every gain (..., w, z) of a stack.

    Raises NumericalFailure for an algebraic loop without a solution.
    """
    n_w, n_z = gain.shape[-2:]
    B1, B2 = system.B[:, :n_w], system.B[:, n_w:]
    C1, C2 = system.C[:n_z], system.C[n_z:]
    D11, D12 = system.D[:n_z, :n_w], system.D[:n_z, n_w:]
    D21, D22 = system.D[n_z:, :n_w], system.D[n_z:, n_w:]

    # w = gain (I - D11 gain)^-1 (C1 x + D12 u)
    check_loop(D11 @ gain)
    feed = gain @ np.linalg.inv(np.eye(n_z) - D11 @ gain)
    by_state, by_input = feed @ C1, feed @ D12
    return system.A + B1 @ by_state, B2 + B1 @ by_input, C2 + D21 @ by_state, D22 + D21 @ by_input


@dataclass(frozen=True, slots=True, eq=False)
class Ports:
    """The channels that all of w (n) and z (n) are made of, by number: inputs (r,) and outputs
    (q,), with into (r, n) and out_of (n, q).

    M11 = out_of M11[outputs, inputs] into at every frequency: parameters that act at one place, or
    on one signal, share channels.
    """

    inputs: np.ndarray
    into: np.ndarray
    outputs: np.ndarray
    out_of: np.ndarray

    def gain(self, wide: np.ndarray) -> np.ndarray:
        """What stands for diag(wide) (..., n) between the channels, (..., r, q)."""
        return np.asarray((self.into * wide[..., None, :]) @ self.out_of)

    def eigenvalues(self, M11: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """Those of M11 diag(wide) (..., r) but for n - r zeros, M11 (..., n, n), wide (..., n)."""
        P = self.gain(wide) @ M11[..., self.outputs[:, None], self.inputs]
        if P.shape[-1] != 2:
            return np.linalg.eigvals(P)

        # the larger one x of half the trace and the root of the discriminant; the other is det / x
        half = 0.5 * (P[..., 0, 0] + P[..., 1, 1])
        off = P[..., 0, 1] * P[..., 1, 0]
        root = np.sqrt(np.square(0.5 * (P[..., 0, 0] - P[..., 1, 1])) + off + 0j)
        x = half + np.where((half.conj() * root).real < 0, -root, root)
        det = P[..., 0, 0] * P[..., 1, 1] - off
        return np.stack([x, det / np.where(x == 0, 1.0, x)], axis=-1)


def ports(system: StateSpace, n: int) -> Ports:
    """Of the leading n inputs and outputs."""
    inputs, into = _spanning(np.vstack([system.B[:, :n], system.D[:, :n]]))
    outputs, out_of = _spanning(np.hstack([system.C[:n], system.D[:n]]).T)
    return Ports(inputs, into, outputs, out_of.T)


def _spanning(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Those of the columns (k, n), by number (r,), that the others are made of, and E (r, n):
    columns[:, numbers] E = columns.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0

    # columns / size = Q R P^T; those beyond the rank are R11^-1 R12 of the first ones
    R, order = sla.qr(columns / size, mode="r", pivoting=True)
    rank = max(int((np.abs(np.diag(R)) > _SAME).sum()), 1)
    E = np.zeros((rank, columns.shape[1]))
    E[:, order] = np.linalg.lstsq(R[:rank, :rank], R[:rank], rcond=None)[0]
    return order[:rank], E * size / size[order[:rank], None]


def upper_lft_responses(M: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """M22 + M21 gain (I - M11 gain)^-1 M12, (d, p, m, k), of responses M (z + p, w + m, k) at k
    frequencies and real gains (d, w, z); not finite at a pole.

    What is solved is of the number of channels w. Of few, all points go side by side.
    """
    d, r, z = gain.shape
    columns, k = M.shape[1:]
    F = np.ascontiguousarray(M.transpose(2, 0, 1))
    if r > _FEW:
        W = (gain[:, None] @ F[:, :z]).reshape(d * k, r, columns)
        solved = memberwise(np.linalg.solve, np.eye(r) - W[:, :, :r], W[:, :, r:])
        T = F[:, z:, r:] + F[:, z:, :r] @ solved.reshape(d, k, r, columns - r)
        return np.asarray(np.moveaxis(T, 1, 3))

    # (I - gain M11, gain M12), (r, columns, k d), the points side by side in memory
    by = gain.transpose(2, 1, 0).reshape(z, r * d)
    whole = np.empty((r, columns, k, d), complex)
    for part, of in ((whole.real, F[:, :z].real), (whole.imag, F[:, :z].imag)):
        rows = of.transpose(2, 0, 1).reshape(columns * k, z)
        part[:] = (rows @ by).reshape(columns, k, r, d).transpose(2, 0, 1, 3)
    side = whole.reshape(r, columns, k * d)
    side[:, :r] *= -1
    side[range(r), range(r)] += 1

    # v = gain z: (I - gain M11) v = gain M12 u, by elimination; a factor beyond 1 / _SMALL spoils
    # digits, and its points are solved with pivoting
    spoilt = np.zeros(k * d, bool)
    with np.errstate(all="ignore"):
        for i in range(r):
            square = side[:, i].real ** 2 + side[:, i].imag ** 2
            spoilt |= ~(square[i] > _SMALL**2 * square.max(axis=0))
            side[i, i + 1 :] *= 1 / side[i, i]
            for j in [*range(i), *range(i + 1, r)]:  # columns up to i are not looked at again
                side[j, i + 1 :] -= side[j, i] * side[i, i + 1 :]
    v = side[:, r:].reshape(r, columns - r, k, d)
    at, member = np.nonzero(spoilt.reshape(k, d))
    Y = gain[member] @ F[at, :z]
    pivoted = memberwise(np.linalg.solve, np.eye(r) - Y[:, :, :r], Y[:, :, r:])
    v[:, :, at, member] = pivoted.transpose(1, 2, 0)
    found = F[:, z:, :r] @ v.transpose(2, 0, 1, 3).reshape(k, r, (columns - r) * d)
    T = found.reshape(k, len(M) - z, columns - r, d) + F[:, z:, r:, None]
    return np.asarray(T.transpose(3, 1, 2, 0))


def design_grid(plant: GeneralizedPlant) -> np.ndarray:
    """Logarithmic frequencies [rad/s] from a decade below the plant's slowest pole to one above the
    fastest.
    """
    size = np.abs(poles(plant.system))

    # Poles at zero (rigid bodies, integrators) set no scale.
    size = size[size > 1e-9 * size.max(initial=0.0)]
    low, high = (size.min() / _MARGIN, size.max() * _MARGIN) if size.size else (1e-2, 1e2)
    return np.geomspace(low, high, max(20, int(np.ceil(_PER_DECADE * np.log10(high / low))) + 1))
