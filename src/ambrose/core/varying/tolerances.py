"""The proof on cells of a loop with parameters within tolerances besides the one that moves.

The tolerances are pulled out of the loop, w_i = delta_i z_i with |delta_i| <= 1 and z = Z x, and so
are multiplied: whatever delta_i is,

    sigma_i = d z_i^2 - d w_i^2 >= 0,    d >= 0,

and V' + sum_i sigma_i + |y|^2 - gamma^2 |d|^2 < 0 on every cell proves gamma for parameters that
move as they like (S-procedure). Of those that stand still more is known: with the filters xi_i' = a
(z_i - xi_i), eta_i' = a (w_i - eta_i) eta_i = delta_i xi_i holds as well, and with v = (z_i, xi_i),
u = (w_i, eta_i)

    sigma_i = v^T D v - u^T D u + 2 g (z_i eta_i - xi_i w_i) >= 0,    D = D^T >= 0, g any number,

at every instant (the D and G of mixed mu as functions of frequency; Veenman, Scherer & Koroglu
2016, Eur. J. Control 31). V is a quadratic function of the loop's state and the filters'. It need
not be positive for all of them: where eta = delta xi its matrix solves a strict Lyapunov inequality
for every frozen delta and p; it is positive for delta = 0, where the loop is stable, and cannot
become singular on the way to another delta.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities.semidefinite import Inequality, minimise, svec
from ambrose.core.varying.cells import Cell, CellSearch, middle_of, own_coordinates
from ambrose.core.varying.proof import Proof

# of gamma, above the smallest found, at which the inequality is checked
_ROOMS = (5e-3, 2e-2, 5e-2)
_REMEDY = "narrower tolerances, a smaller range or a slower motion help"
_TURNS, _WORTH = 10, 0.98  # of the search in its own solution's states, and what a turn must gain
_LESS = 0.25  # of the tolerances, where all of them have no solution in the states at hand
_USELESS = 100.0  # gain, beyond which nothing is called proved
_LIGHT = 1e-9  # of X's largest eigenvalue, below which a direction counts as of that size


def proved_over_tolerances(
    cells: Sequence[Cell],
    C: np.ndarray,
    Z: np.ndarray,
    rate: float = np.inf,
    *,
    pole: float | None = None,
    degree: int = 1,
    time_limit: float = 600.0,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """The smallest gamma from d to y = C x + d for which a proof is found, for all motions within
    the cells with |p'| <= rate.

    cells: B (.., n, r + q), the columns of w before those of d; C (q, n), Z (r, n); pole [rad/s]: a
    of the filters for parameters that stand still; None: they move as they like. degree: of X(p).
    Raises NumericalFailure where none is found.
    """
    end = time.monotonic() + time_limit
    A, B = middle_of(cells)
    q = len(C)
    T, inverse = own_coordinates(A, B[:, -q:], C)

    # a parameter whose z is zero does nothing: w = delta z = 0
    acts = Z.any(axis=1)
    if not acts.all():
        columns = np.append(acts, np.ones(q, bool))
        cells = [replace(cell, B=cell.B[..., columns]) for cell in cells]
        Z = Z[acts]

    # w and z in units in which each row of Z is 1 long in the middle loop's states; delta stays
    size = np.linalg.norm(Z @ T, axis=1)
    cells, Z = [_scaled(cell, size) for cell in cells], Z / size[:, None]

    # states (x, xi, eta), the filters' as they are
    if pole is not None and len(Z):
        cells, C, Z = _with_filters(cells, C, Z, pole)
        T, inverse = (
            np.pad(M, (0, 2 * len(size))) + np.diag(np.repeat([0.0, 1.0], [len(M), 2 * len(size)]))
            for M in (T, inverse)
        )
    # share of the tolerances, by which states are found
    least = np.inf
    unit = np.ones(len(size))
    count = len(size)
    share = 1.0
    for _ in range(_TURNS):
        search = _Tolerant(
            [_scaled(cell, share / unit) for cell in cells],
            C,
            Z,
            rate,
            degree,
            (T, inverse),
            count,
            unit,
        )
        # the smallest gamma^2 in these states and units, for the share of the tolerances
        first = minimise(
            search.cost, search.inequalities(), tolerance=3e-3, time_limit=end - time.monotonic()
        )
        held = first.status in ("optimal", "inexact") and first.x[-1] > 0

        # all the tolerances are in: a gamma, and the turns end where one gains too little
        if held and share == 1.0:
            if not np.sqrt(first.x[-1]) < _WORTH * least:
                break
            least = float(np.sqrt(first.x[-1]))
            tell(f"gain below {least:.4f}")
        elif least < np.inf or time.monotonic() > end:
            break
        # no solution in these states: first for a smaller share
        if not held:
            share *= _LESS
            continue

        # the next turn's states: X_0 = V diag(values) V^T becomes diag(+-1)
        values, V = np.linalg.eigh(search.functions(first.x)[0])
        root = np.sqrt(np.maximum(np.abs(values), _LIGHT * np.abs(values).max()))
        T, inverse = T @ (V / root), (V * root).T @ inverse

        # its units of w, in which this d (or D_11) would be 1; and twice the share
        d = first.x[search.begin :][: search.each * count : search.each]
        unit, share = (
            unit * np.sqrt(np.maximum(d, np.finfo(float).tiny)),
            min(1.0, share / _LESS**0.5),
        )
    if not least < _USELESS:
        raise NumericalFailure(
            f"no quadratic function proves the loop over its tolerances ({first.status}); {_REMEDY}"
        )
    search = _Tolerant(
        [_scaled(cell, 1 / unit) for cell in cells], C, Z, rate, degree, (T, inverse), count, unit
    )

    # gamma given, the slack is made largest; what is found is checked at every entry
    for room in _ROOMS:
        gamma = least * (1 + room)
        found = minimise(
            -search.cost,
            search.inequalities(gamma),
            tolerance=1e-3,
            time_limit=end - time.monotonic(),
        )
        X, m = search.functions(found.x), found.x[search.begin : -1]
        slack = -float(search.excess_with(X, m, gamma).max())
        rounding = search.rounding_with(X, m, gamma)
        if search.admitted(m) and slack > rounding:
            return Proof(gamma, X, slack, rounding)
    raise NumericalFailure(
        f"the inequality does not hold with certainty (by {slack:.1e}, rounding {rounding:.1e}); "
        f"{_REMEDY}"
    )


def _scaled(cell: Cell, size: np.ndarray) -> Cell:
    """With the columns of w times size (r,)."""
    B = cell.B.copy()
    B[..., : len(size)] *= size
    return replace(cell, B=B)


def _with_filters(
    cells: Sequence[Cell], C: np.ndarray, Z: np.ndarray, pole: float
) -> tuple[list[Cell], np.ndarray, np.ndarray]:
    """Cells and C of the states (x, xi, eta), and the rows of z, xi and eta over them (3 r, n + 2
    r).
    """
    r, n = Z.shape
    wide = []
    for cell in cells:
        A = np.pad(cell.A, ((0, 0), (0, 0), (0, 2 * r), (0, 2 * r)))
        B = np.pad(cell.B, ((0, 0), (0, 0), (0, 2 * r), (0, 0)))
        # xi' = a (z - xi) with z = Z x,   eta' = a (w - eta)
        A[..., n : n + r, :n] = pole * Z
        A[..., n:, n:] -= pole * np.eye(2 * r)
        B[..., n + r :, :r] += pole * np.eye(r)
        wide.append(replace(cell, A=A, B=B))
    return (
        wide,
        np.pad(C, ((0, 0), (0, 2 * r))),
        np.vstack([np.pad(Z, ((0, 0), (0, 2 * r))), np.eye(2 * r, n + 2 * r, n)]),
    )


class _Tolerant(CellSearch):
    """The inequalities over (x, w, d) with the multipliers' numbers after X's: a parameter's d, or
    D (3) and g; gamma^2 last.

    rows: of z, or of z, xi and eta, in the states given; unit (r,): w is in, so that d is about 1.
    """

    def __init__(
        self,
        cells: Sequence[Cell],
        C: np.ndarray,
        rows: np.ndarray,
        rate: float,
        degree: int,
        coordinates: tuple[np.ndarray, np.ndarray],
        count: int,
        unit: np.ndarray | None = None,
    ) -> None:
        super().__init__(cells, C, rate, degree, 1.0, coordinates)
        n, q = self.T.shape[1], len(C)
        unit = np.ones(count) if unit is None else unit

        # (z), or (z, xi, eta), of each parameter as rows over (x, w, d): in the search's states and
        # time (hence 1/sqrt(pace)), times unit, as w is
        seen = (
            rows @ self.T / np.sqrt(self.pace) * np.tile(unit, len(rows) // max(1, count))[:, None]
        )
        seen = np.pad(seen, ((0, 0), (0, count + q))).reshape(
            len(rows) // max(1, count), count, n + count + q
        )
        w = np.eye(count, n + count + q, n)
        self.each, self.begin, self.count, self.w = (
            (4 if len(seen) == 3 else 1),
            self.variables[-1].stop,
            count,
            w,
        )
        self.forms: list[np.ndarray] = []
        for i in range(count):
            # d, or D_11: z^2 - w^2
            z = seen[0, i]
            self.forms.append(_product(z, z) - _product(w[i], w[i]))
            if self.each == 4:
                # D_12: 2 (z xi - w eta), D_22: xi^2 - eta^2, g: 2 (z eta - xi w)
                xi, eta = seen[1:, i]
                self.forms += [
                    2 * (_product(z, xi) - _product(w[i], eta)),
                    _product(xi, xi) - _product(eta, eta),
                ]
                self.forms.append(2 * (_product(z, eta) - _product(xi, w[i])))

    @property
    def size(self) -> int:
        return self.variables[-1].stop + self.each * self.count + 1

    @property
    def cost(self) -> np.ndarray:
        return np.eye(1, self.size, self.size - 1)[0]

    def inequalities(self, gamma: float | None = None) -> list[Inequality]:
        """All of them; with a gamma the last variable is by how much they hold."""
        # -(V' + sigma + |y|^2 - gamma^2 |d|^2) >= 0 (with a gamma: >= last I) over (x, w, d)
        n, q = len(self.T), len(self.C)
        corner = np.diag(np.repeat([0.0, 0.0, 1.0], [n, self.count, q]))
        last = svec(corner) if gamma is None else -svec(np.eye(len(corner)))
        rows = np.column_stack([*(-svec(form) for form in self.forms), last])
        columns = np.arange(self.begin, self.size)
        given = 0.0 if gamma is None else gamma**2 * svec(corner)
        found = [
            replace(item, rows=rows, columns=columns, constant=item.constant + given)
            for item in map(self.inequality, self.entries)
        ]
        return [*found, *self._positive(), self.bound()]

    def _positive(self) -> list[Inequality]:
        # d >= 0, or D = [D_11, D_12; D_12, D_22] >= 0; g is free
        entries = (
            [[[1, 0], [0, 0]], [[0, 1], [1, 0]], [[0, 0], [0, 1]]] if self.each == 4 else [[[1]]]
        )
        rows = np.column_stack([svec(np.array(E, float)) for E in entries])
        starts = self.begin + self.each * np.arange(self.count)
        return [
            Inequality(rows, np.zeros(len(rows)), start + np.arange(rows.shape[1]))
            for start in starts.tolist()
        ]

    def admitted(self, m: np.ndarray) -> bool:
        """Whether every D is positive semidefinite."""
        D = m.reshape(self.count, self.each)
        return bool(
            (D[:, 0] > 0).all() and (self.each == 1 or (D[:, 0] * D[:, 2] >= D[:, 1] ** 2).all())
        )

    def excess_with(self, X: np.ndarray, m: np.ndarray, gamma: float) -> np.ndarray:
        """``excess`` with the multipliers of the numbers m."""
        n, q = len(self.T), len(self.C)

        # sigma + |d|^2 - gamma^2 |d|^2, the same at every entry
        fixed = sum(
            (a * form for a, form in zip(m, self.forms, strict=True)),
            np.zeros((n + self.count + q,) * 2),
        )
        fixed[n + self.count :, n + self.count :] += (1 - gamma**2) * np.eye(q)
        found = []
        for e in self.entries:
            # rows of x, half of it: V' + |C x|^2 + 2 x^T C^T d
            half = np.hstack(
                [
                    (X @ e.A).sum(0) + np.tensordot(e.slope / 2, X, 1) + self.C.T @ self.C / 2,
                    (X @ e.B).sum(0),
                ]
            )
            half[:, n + self.count :] += self.C.T
            found.append(
                np.linalg.eigvalsh(
                    fixed
                    + np.pad(half, ((0, self.count + q), (0, 0)))
                    + np.pad(half, ((0, self.count + q), (0, 0))).T
                )[-1]
            )
        return np.array(found)

    def rounding_with(self, X: np.ndarray, m: np.ndarray, gamma: float) -> float:
        """``rounding``, and that of the multipliers' forms."""
        size = sum(
            abs(a) * float(np.linalg.norm(form)) for a, form in zip(m, self.forms, strict=True)
        )
        return self.rounding(X, gamma) + 4 * (len(self.T) + self.count) * np.finfo(float).eps * size


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (np.outer(a, b) + np.outer(b, a)) / 2
