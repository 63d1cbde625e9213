"""Linear time-invariant systems with named signals, and their algebra.

Signals are picked by name; integers never select a channel outside ``core``. All functions return
new systems. Any argument documented as a *system* may also be a python-control system (a
``ControllerLike``).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_finite,
    check_positive,
    check_shape,
    invalid,
    named_failure,
    names_wrong_types,
    same_clock,
)
from ambrose.core.presentation import Presented

# Diagonal scaling of state-space matrices: exact (powers of two), cheap, and worth several digits.


def balance_matrix(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal similarity that evens out row and column norms: T^-1 A T with T = diag(t), and t
    (n,). Exact (powers of 2).

    A (..., n, n); of a stack: one t for all, by their largest entries. Source: Parlett & Reinsch
    1969 (LAPACK's gebal, without permutations).
    """
    n = A.shape[-1]
    if n == 0:
        return A, np.ones(0)
    size = np.abs(A).reshape(-1, n, n).max(axis=0)
    t = sla.lapack.dgebal(size, scale=1, permute=0)[3]
    return A * t / t[:, None], t


def balance_system(
    A: np.ndarray, B: np.ndarray, C: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State scaling x = diag(t) z that evens out A, B and C together: T^-1 A T, T^-1 B, C T and t
    (n,).

    A (n, n), B (n, m), C (p, n). Inputs and outputs keep their units; one more row and column, the
    norms of B and C, stand for them while balancing.
    """
    n = A.shape[0]

    # [|A| |B|; |C| 0] with B and C as one column and one row of norms.
    joint = np.zeros((n + 1, n + 1))
    joint[:n, :n] = np.abs(A)
    joint[:n, n] = np.linalg.norm(B, axis=1)
    joint[n, :n] = np.linalg.norm(C, axis=0)

    # The last factor, that of the signals, is set to one.
    t = balance_matrix(joint)[1]
    t = t[:n] / t[n]
    return A * t / t[:, None], B / t[:, None], C * t, t


Names = str | Sequence[str]


class ControllerLike(Protocol):
    """Anything that is a linear system: a StateSpace, a python-control or scipy.signal system.

    A (n, n), B (n, m), C (p, n), D (p, m). Its sample time ``dt`` [s] (None or 0: continuous) and
    its signal names (``inputs``, ``outputs``, or python-control's ``input_labels``,
    ``output_labels``) are read where it has them.
    """

    @property
    def A(self) -> Any: ...

    @property
    def B(self) -> Any: ...

    @property
    def C(self) -> Any: ...

    @property
    def D(self) -> Any: ...


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class StateSpace(Presented):
    """x' = A x + B u, y = C x + D u; with ``dt`` [s] given, x[k+1] = A x[k] + B u[k].

    A (n, n), B (n, m), C (p, n), D (p, m): real arrays, kept read-only. ``inputs`` (m names) and
    ``outputs`` (p names) default to u1.. and y1... ``StateSpace(system)`` takes all of it from a
    python-control system (a ``ControllerLike``). Raises InvalidInput on shapes that do not fit,
    non-finite entries or repeated names.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float | None

    @names_wrong_types
    def __init__(
        self,
        A: ArrayLike | ControllerLike,
        B: ArrayLike | None = None,
        C: ArrayLike | None = None,
        D: ArrayLike | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        dt: float | None = None,
    ) -> None:
        given: Any = A
        if is_system(given):
            inputs = _names_of(given, "input") if inputs is None else inputs
            outputs = _names_of(given, "output") if outputs is None else outputs
            dt = _sample_time_of(given) if dt is None else dt
            given, B, C, D = given.A, given.B, given.C, given.D
        if B is None or C is None or D is None:
            raise InvalidInput(
                "a StateSpace needs its matrices A, B, C and D, or one system that has them"
            )
        A, B, C, D = (
            np.asarray(check_finite(x, letter))
            for x, letter in zip((given, B, C, D), "ABCD", strict=True)
        )
        A, B, C, D = (np.atleast_2d(x) if x.ndim == 0 else x for x in (A, B, C, D))  # scalars
        D = np.atleast_2d(D)
        p, m = D.shape if D.ndim == 2 else check_shape(D, "D", "(p, m)").shape
        n = A.shape[0] if A.size else 0
        # empty in another way, or refused
        if (A.shape, B.shape, C.shape) != ((n, n), (n, m), (p, n)):
            A = check_shape(A.reshape(n, n) if A.size == n * n else A, "A", "(n, n)")
            B = check_shape(B.reshape(0, m) if n == B.size == 0 else B, "B", "(n, m)", n=n, m=m)
            C = check_shape(C.reshape(p, 0) if n == C.size == 0 else C, "C", "(p, n)", p=p, n=n)
        for letter, matrix in zip("ABCD", (A, B, C, D), strict=True):
            if np.iscomplexobj(matrix):
                raise invalid(
                    f"matrix {letter}", "complex", "real", "transform to a real state basis first"
                )
            frozen = np.array(matrix, dtype=float)
            frozen.flags.writeable = False
            object.__setattr__(self, letter, frozen)
        object.__setattr__(self, "inputs", _names(inputs, "u", m, "inputs"))
        object.__setattr__(self, "outputs", _names(outputs, "y", p, "outputs"))
        if dt is not None:
            if isinstance(dt, bool):
                raise invalid(
                    "dt",
                    dt,
                    "the sample time in seconds, or None",
                    "True and False are not durations",
                )
            dt = check_positive(
                dt, "dt", "give the sample time in seconds, or None for continuous time"
            )
        object.__setattr__(self, "dt", dt)

    @property
    def n_states(self) -> int:
        return self.A.shape[0]

    def __repr__(self) -> str:
        time = "continuous" if self.dt is None else f"dt = {self.dt:g} s"
        return (
            f"StateSpace({self.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} "
            f"outputs, {time})"
        )

    def facts(self) -> Mapping[str, Any]:
        """Its size, its signals and its sample time."""
        time = "continuous" if self.dt is None else f"sampled, dt = {self.dt:g} s"
        return {
            "states": self.n_states,
            "inputs": self.inputs,
            "outputs": self.outputs,
            "time": time,
        }

    def to_control(self) -> Any:
        """The same system as a ``control.StateSpace`` with signal labels (python-control must be
        installed).
        """
        import control

        return control.ss(
            self.A,
            self.B,
            self.C,
            self.D,
            0 if self.dt is None else self.dt,
            inputs=list(self.inputs),
            outputs=list(self.outputs),
        )


def _names(names: Sequence[str] | None, letter: str, count: int, what: str) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{letter}{i + 1}" for i in range(count))
    result = (names,) if isinstance(names, str) else tuple(names)
    if len(result) != count:
        raise invalid(
            f"the number of {what} names",
            len(result),
            f"{count}",
            "give one name for each column or row of D",
        )
    if len(set(result)) < count:
        repeated = sorted({name for name in result if result.count(name) > 1})
        raise invalid(
            f"the {what} names",
            f"repeating {', '.join(repeated)}",
            "unique",
            "rename() one of the systems first",
        )
    return result


def is_system(value: object) -> TypeGuard[ControllerLike]:
    """Whether it has matrices A, B, C and D."""
    return all(hasattr(value, letter) for letter in "ABCD")


def _names_of(system: ControllerLike, side: str) -> Sequence[str] | None:
    # scipy.signal counts its inputs
    names = (getattr(system, name, None) for name in (f"{side}_labels", f"{side}s"))
    return next((name for name in names if isinstance(name, list | tuple)), None)


def _sample_time_of(system: ControllerLike) -> float | None:
    dt = getattr(system, "dt", None)
    if dt is True:
        raise InvalidInput(
            "the system's dt is True (discrete, unspecified); give the sample time in seconds"
        )
    return dt or None


def as_statespace(system: Any) -> StateSpace:
    """``system`` as a StateSpace: itself, a python-control system, or an array taken as a static
    gain.
    """
    if isinstance(system, StateSpace):
        return system
    if is_system(system):
        return StateSpace(system)
    if hasattr(system, "num") and hasattr(system, "den"):
        raise InvalidInput("a transfer function was given; convert it with control.ss(...) first")
    if not isinstance(system, np.ndarray | np.generic | list | tuple | int | float):
        remedy = "give a StateSpace, a python-control system or an array of gains"
        raise invalid(
            "the system", f"{system!r:.60}", "something with matrices A, B, C and D", remedy
        )
    return static_gain(check_finite(system, "the constant gain"))


def static_gain(
    D: ArrayLike,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    dt: float | None = None,
) -> StateSpace:
    """The system y = D u without states; D (p, m) or (): a scalar; a row (m,) is one output. Raises
    InvalidInput.
    """
    D = check_finite(D, "D")
    if D.ndim > 2 or (D.ndim == 1 and not D.size):
        raise invalid("the shape of D", D.shape, "(p, m), (m,) or ()", "give a row per output")
    D = np.atleast_2d(D)
    p, m = D.shape
    return StateSpace(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), D, inputs, outputs, dt)


def transfer_function(
    numerator: ArrayLike,
    denominator: ArrayLike,
    input: str = "u1",
    output: str = "y1",
    dt: float | None = None,
) -> StateSpace:
    """One-input one-output system from polynomial coefficients, highest power first (controllable
    canonical form).

    The states are scaled so that A and B are balanced. Raises InvalidInput when improper or the
    leading coefficient is 0.
    """
    num, den = _polynomial(numerator, "numerator"), _polynomial(denominator, "denominator")
    num = np.trim_zeros(num, "f")
    if den[0] == 0:
        raise invalid(
            "the leading denominator coefficient", 0, "non-zero", "drop the leading zeros"
        )
    if len(num) > len(den):
        raise invalid(
            "the numerator's order", len(num) - 1, f"at most {len(den) - 1}", "add a roll-off pole"
        )
    n = len(den) - 1
    b = np.concatenate([np.zeros(len(den) - len(num)), num]) / den[0]
    a = den / den[0]
    if n == 0:
        return static_gain(b[:1, None], [input], [output], dt)
    A = np.vstack([-a[1:], np.eye(n)[:-1]])
    B = np.eye(n)[:, :1]
    C = (b[1:] - b[0] * a[1:])[None, :]
    A, B, C, _ = balance_system(A, B, C)
    return StateSpace(A, B, C, [[b[0]]], [input], [output], dt)


def _polynomial(coefficients: ArrayLike, name: str) -> np.ndarray:
    values = check_shape(np.atleast_1d(check_finite(coefficients, name)), name, "(k)")
    if np.iscomplexobj(values) or not values.size:
        raise invalid(
            name,
            values.tolist(),
            "at least one real coefficient",
            "give them from the highest power down",
        )
    return values


def poles(system: Any) -> np.ndarray:
    """Eigenvalues of A, (n,) complex [rad/s, or z-plane when sampled], sorted by modulus."""
    system = as_statespace(system)
    values = (
        np.linalg.eigvals(system.A).astype(complex) if system.n_states else np.zeros(0, complex)
    )
    return values[np.lexsort((values.imag, values.real, np.abs(values)))]


def spectral_abscissa(system: Any) -> float:
    """Largest real part of the poles [rad/s]; for a sampled system ln|z|/dt of the outermost pole.
    -inf without states.
    """
    system = as_statespace(system)
    values = poles(system)
    if values.size == 0 or system.dt is None:
        return float(values.real.max(initial=-np.inf))
    return float(np.log(np.maximum(np.abs(values).max(), np.finfo(float).tiny)) / system.dt)


def is_stable(system: Any) -> bool:
    """Whether every pole lies strictly inside the stability region."""
    return spectral_abscissa(system) < 0


def index_of(names: Names, available: Sequence[str], what: str) -> list[int]:
    """Positions of ``names`` in ``available``; raises InvalidInput naming the unknown one and the
    known ones.
    """
    wanted = [names] if isinstance(names, str) else list(names)
    position = {name: i for i, name in enumerate(available)}
    for name in wanted:
        if name not in position:
            raise InvalidInput(
                f"{what} {name!r} is not a signal of this system; it has "
                f"{', '.join(available) or 'none'}"
            )
    return [position[name] for name in wanted]


def select(system: Any, inputs: Names | None = None, outputs: Names | None = None) -> StateSpace:
    """The subsystem between the named inputs and outputs, in the order given; None keeps all.
    States are kept.
    """
    system = as_statespace(system)
    j = index_of(system.inputs if inputs is None else inputs, system.inputs, "input")
    i = index_of(system.outputs if outputs is None else outputs, system.outputs, "output")
    return StateSpace(
        system.A,
        system.B[:, j],
        system.C[i],
        system.D[np.ix_(i, j)],
        [system.inputs[k] for k in j],
        [system.outputs[k] for k in i],
        system.dt,
    )


def rename(
    system: Any,
    inputs: Mapping[str, str] | Sequence[str] | None = None,
    outputs: Mapping[str, str] | Sequence[str] | None = None,
) -> StateSpace:
    """The same system with other signal names: a full list, or a mapping from old to new."""
    system = as_statespace(system)

    def new(
        names: tuple[str, ...], change: Mapping[str, str] | Sequence[str] | None, what: str
    ) -> Sequence[str]:
        if isinstance(change, Mapping):
            index_of(list(change), names, what)
            return [change.get(name, name) for name in names]
        return names if change is None else change

    return StateSpace(
        system.A,
        system.B,
        system.C,
        system.D,
        new(system.inputs, inputs, "input"),
        new(system.outputs, outputs, "output"),
        system.dt,
    )


def match_signals(system: Any, inputs: Sequence[str], outputs: Sequence[str]) -> StateSpace:
    """The system with its signals in the order of ``inputs`` and ``outputs``, and with these names.

    A side that has the same names in another order is permuted; any other side is taken by place.
    Raises InvalidInput where the numbers of signals differ.
    """
    system = as_statespace(system)
    for side, names in (("inputs", inputs), ("outputs", outputs)):
        existing = getattr(system, side)
        if set(names) == set(existing) and tuple(names) != existing:
            system = select(system, **{side: names})
    return rename(system, inputs, outputs)


def append(*systems: Any) -> StateSpace:
    """Block-diagonal combination: all inputs and all outputs side by side (names must not
    repeat).
    """
    parts = [as_statespace(s) for s in systems]
    A, B, C, D = (_side_by_side([getattr(s, letter) for s in parts]) for letter in "ABCD")
    return StateSpace(
        A,
        B,
        C,
        D,
        [name for s in parts for name in s.inputs],
        [name for s in parts for name in s.outputs],
        _common_dt(parts),
    )


def _side_by_side(blocks: list[np.ndarray]) -> np.ndarray:
    """The block-diagonal matrix, in a tenth of the time of scipy's where blocks are small."""
    whole = np.zeros(
        np.sum([block.shape for block in blocks], axis=0, dtype=int) if blocks else (0, 0)
    )
    row = column = 0
    for block in blocks:
        rows, columns = block.shape
        whole[row : row + rows, column : column + columns] = block
        row, column = row + rows, column + columns
    return whole


def _common_dt(systems: Iterable[StateSpace]) -> float | None:
    """The sample time shared by all systems that have one; static gains go with any."""
    times = list(dict.fromkeys(s.dt for s in systems if s.n_states or s.dt is not None))
    first = next(iter(times), None)
    sampled = [t for t in times if t is not None]
    if len(times) > 1 and (
        first is None or len(sampled) < len(times) or not all(same_clock(t, first) for t in sampled)
    ):
        raise invalid(
            "the sample times", sorted(map(str, times)), "equal", "resample with sampling.c2d first"
        )
    return first


def series(first: Any, second: Any) -> StateSpace:
    """``second`` after ``first``: every output of the first feeds the input of the second in the
    same place.
    """
    first, second = as_statespace(first), as_statespace(second)
    if len(first.outputs) != len(second.inputs):
        raise invalid(
            "the first system's output count",
            len(first.outputs),
            str(len(second.inputs)),
            "select() signals",
        )
    A = np.block(
        [[first.A, np.zeros((first.n_states, second.n_states))], [second.B @ first.C, second.A]]
    )
    return StateSpace(
        A,
        np.vstack([first.B, second.B @ first.D]),
        np.hstack([second.D @ first.C, second.C]),
        second.D @ first.D,
        first.inputs,
        second.outputs,
        _common_dt([first, second]),
    )


def feedback(forward: Any, backward: Any, sign: int = -1) -> StateSpace:
    """The loop y = forward (r + sign * backward y), from r to y with the names of ``forward``.

    Raises NumericalFailure for an algebraic loop that has no solution.
    """
    forward, backward = as_statespace(forward), as_statespace(backward)
    if forward.D.shape != backward.D.shape[::-1]:
        raise invalid(
            "the feedback's size", backward.D.shape, str(forward.D.shape[::-1]), "select() signals"
        )
    if sign not in {-1, 1}:
        raise invalid("the feedback's sign", sign, "-1 or 1", "put a gain into the backward system")
    parts = [StateSpace(s.A, s.B, s.C, s.D, dt=s.dt) for s in (forward, backward)]
    p, m = forward.D.shape
    joined = append(
        parts[0], rename(parts[1], [f"v{i}" for i in range(p)], [f"b{i}" for i in range(m)])
    )
    loop = np.zeros((m + p, p + m))
    loop[:m, p:] = sign * np.eye(m)
    loop[m:, :p] = np.eye(p)
    closed = close(joined, loop)
    return StateSpace(
        closed.A,
        closed.B[:, :m],
        closed.C[:p],
        closed.D[:p, :m],
        forward.inputs,
        forward.outputs,
        closed.dt,
    )


@named_failure("the closed loop")
def close(system: StateSpace, loop: np.ndarray) -> StateSpace:
    """``system`` with its own outputs fed back, u = loop y + r; loop (m, p). From r to y, names
    kept.

    Raises NumericalFailure when I - D loop is singular (an algebraic loop).
    """
    loop = check_shape(loop, "loop", "(m, p)", m=len(system.inputs), p=len(system.outputs))
    DL = system.D @ loop
    check_loop(DL)
    E = np.eye(len(DL)) - DL
    # y = E^-1 (C x + D r)
    C, D = np.linalg.solve(E, system.C), np.linalg.solve(E, system.D)
    BL = system.B @ loop
    return StateSpace(
        system.A + BL @ C, system.B + BL @ D, C, D, system.inputs, system.outputs, system.dt
    )


def check_loop(DL: np.ndarray) -> None:
    """Raises NumericalFailure where I - DL is singular, for a stack (..., p, p)."""
    if DL.any() and np.abs(1 - np.linalg.eigvals(DL)).min() < 1e-14 * max(
        1.0, float(np.abs(balance_matrix(DL)[0]).max())
    ):
        raise NumericalFailure(
            "the loop is algebraic (I - D L is singular); add a sample of delay or a roll-off pole"
        )


def connect(
    systems: Sequence[Any],
    inputs: Sequence[str],
    outputs: Sequence[str],
    sums: Mapping[str, Sequence[str]] | None = None,
) -> StateSpace:
    """Interconnection by name.

    An input of a system is fed by the output (of any system) or the external input of the same
    name, unless ``sums`` says what it is: ``sums={"e_A": ["r_A", "-y_A"]}`` makes the input e_A
    equal r_A - y_A; an empty list makes it zero. The terms of a sum, and ``outputs``, name a
    system's output, an external input or another sum, looked up in that order. Raises InvalidInput
    for a name that leads nowhere, and for sums that need each other.
    """
    joined = append(*systems)
    sums = {} if sums is None else dict(sums)
    sources = [*joined.outputs, *inputs]
    repeated = sorted(set(joined.outputs) & set(inputs))
    if repeated:
        raise invalid(
            "the external inputs",
            ", ".join(repeated),
            "different from the systems' outputs",
            "rename them",
        )
    position = {name: i for i, name in enumerate(sources)}

    used: set[str] = set()

    def signal(name: str, wanted_by: tuple[str, ...]) -> np.ndarray:
        if name in position:
            return np.eye(1, len(sources), position[name])[0]
        if name not in sums:
            by = f" (wanted by {wanted_by[-1]!r})" if wanted_by else ""
            raise InvalidInput(
                f"signal {name!r}{by} is neither a system's output, an external input nor a sum"
            )
        if name in wanted_by:
            raise InvalidInput(
                f"the sums {' <- '.join([*wanted_by, name])} need each other; break the circle "
                "with a system"
            )
        return total(name, wanted_by)

    def total(name: str, wanted_by: tuple[str, ...] = ()) -> np.ndarray:
        used.add(name)
        coefficients = np.zeros(len(sources))
        for term in sums[name]:
            sign, source = (-1.0, term[1:]) if term.startswith("-") else (1.0, term)
            coefficients += sign * signal(source, (*wanted_by, name))
        return coefficients

    rows = [total(name) if name in sums else signal(name, ("an input",)) for name in joined.inputs]
    mixing = np.array(rows).reshape(len(joined.inputs), len(sources))
    p = len(joined.outputs)
    closed = close(joined, mixing[:, :p])
    B, D = closed.B @ mixing[:, p:], closed.D @ mixing[:, p:]
    pick = np.array([signal(name, ()) for name in outputs]).reshape(len(outputs), len(sources))
    if set(sums) - used:
        raise InvalidInput(
            f"the sum {sorted(set(sums) - used)[0]!r} is not used: it is neither an input, an "
            "output nor a term"
        )
    C, D = pick[:, :p] @ closed.C, pick[:, :p] @ D + pick[:, p:]
    return StateSpace(closed.A, B, C, D, list(inputs), list(outputs), closed.dt)
