"""A frequency response by the local polynomial method: no window, no leakage, the resolution of the
whole record.

Around every line response and transient are polynomials of the line's number, fitted by least
squares over the lines beside it; what they leave is noise (Pintelon & Schoukens 2012, ch. 7). A
window smears a resonance and takes its leakage for noise; here both are of third order in the width
of the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft

from ambrose.core.checks import InvalidInput, invalid, same_clock
from ambrose.core.statespace import Names
from ambrose.identification.excitation import signal_rows
from ambrose.identification.frf.spectral import Frf
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.record.record import Record

_DEGREE = 2  # of the local polynomial (Pintelon & Schoukens 2012, ch. 7)
_INDEPENDENT = 1e-5  # least singular value of the lines' matrix, columns of unit length
_SPREAD = 1.5  # lines with power for every unknown of the response, at least
_SPARSE = 0.3  # of a band's lines: where fewer have power, noise is told from these
_WIDER = (1.0, 3.0, 9.0)  # bands tried, in widths of the least
_WORSE = 1.25  # times the noise of the least band, up to which a wider one is no worse


def local_response(
    records: Record | Sequence[Record],
    inputs: Names,
    outputs: Names,
    *,
    freedom: int = 20,
    band: tuple[float, float] = (0.0, np.inf),
    harmonics: int = 3,
    periodic: bool = False,
    at: Sequence[float] | None = None,
    beside: Sequence[float] = (),
    sharp: Sequence[tuple[float, float, float]] = (),
    sparse: bool = False,
) -> Frf:
    """The response of ``outputs`` to excitations ``inputs`` (e_, r_ or d_<axis>), which are free of
    noise, over all records.

    freedom: degrees of freedom of the noise estimate at every line, which with the number of
    unknowns makes the least band that is fitted together; up to nine times that where the
    polynomials leave no more. band [rad/s]: kept. harmonics: multiples of the speed up to which
    unbalance and run-out are taken out. periodic: each record is one whole period, without
    transient. at [rad/s]: the lines wanted, of which those that cannot be told are left out (None:
    as dense as the record allows); beside [rad/s]: further ones between these. sharp: (from, to,
    width) [rad/s] of resonances between which no wider band than this, or the least, is fitted:
    noise may hide that a polynomial does not follow one. sparse: take the least band also where
    fewer lines in it have power than the response has unknowns, as of a sequence that repeats: for
    who weighs the misfit himself; a wider band follows a phase less. Bands overlap: neighbouring
    lines are not independent. Raises InvalidInput where the records are too short, or the inputs
    alike.
    """
    u, y = (tuple([names] if isinstance(names, str) else names) for names in (inputs, outputs))
    records = (records,) if isinstance(records, Record) else tuple(records)
    dt, m = records[0].dt, len(u)
    if not all(same_clock(record.dt, dt) for record in records):
        raise InvalidInput(
            "the records have different sample rates; estimate a response from records of one rate"
        )
    spectra = [_spectra(without_synchronous(record, harmonics), (*u, *y)) for record in records]
    spans = np.array([record.values.shape[1] * dt for record in records])
    still = [
        name
        for name, row in zip(u, np.hstack([Z[:m] for Z in spectra]), strict=True)
        if not np.abs(row).any()
    ]
    if still:
        raise InvalidInput(
            f"{', '.join(still)} never changes in these records; excite it, or leave it out"
        )
    width = band_width(m, len(records), float(spans.sum()), freedom, periodic)
    low, high = max(band[0], width), min(band[1], 0.98 * np.pi / dt - width / 2)
    if high <= low + 2 * width:
        requirement = (
            f"so long that {width / 2 / np.pi:.3g} Hz, the band fitted together, is far below the "
            "highest frequency"
        )
        raise invalid(
            "the length of the records", f"{spans.sum():g} s", requirement, "record longer"
        )

    def widest(centre: float) -> float:
        """The widest band [rad/s] that may be fitted about a line."""
        return min((own for start, end, own in sharp if start <= centre <= end), default=np.inf)

    lines = []
    centre = low
    wanted = None if at is None else iter(sorted(w for w in at if low <= w <= high))
    while centre < high:
        if wanted is not None and (centre := next(wanted, np.inf)) == np.inf:
            break
        most = widest(centre)
        narrow, wider = _line(spectra, spans, m, centre, width, dt, periodic, most, sparse)
        if narrow is not None:
            lines.append((centre, *narrow))
        centre += width * max(0.5, wider / 6)  # a third of half the band that was fitted
    for centre in sorted({w for w in beside if low <= w < high} - {line[0] for line in lines}):
        most = widest(centre)
        found, _ = _line(spectra, spans, m, centre, width, dt, periodic, most, sparse)
        if found is not None:
            lines.append((centre, *found))
    lines.sort(key=lambda line: line[0])
    if not lines:
        raise InvalidInput(
            f"the excitations {', '.join(u)} are alike, or hold no power in the band; excite each "
            "by a pattern of its own"
        )
    omega, G, noise, share, coherence = (np.array(part) for part in zip(*lines, strict=True))
    variance = (
        np.einsum("wii->wi", noise).real[:, :, None] * np.einsum("wii->wi", share).real[:, None, :]
    )
    return Frf(
        G,
        omega,
        u,
        y,
        variance,
        coherence,
        np.ones((len(omega), m)),
        float(freedom),
        dt,
        noise,
        share,
    )


def band_width(
    inputs: int, records: int, span: float, freedom: int = 20, periodic: bool = False
) -> float:
    """The least band [rad/s] that is fitted together about a line, from ``span`` [s] in all."""
    unknowns = (_DEGREE + 1) * (inputs + (0 if periodic else records))
    return 2 * np.pi * (unknowns + freedom + records) / span


_Fit = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _line(
    spectra: list[np.ndarray],
    spans: np.ndarray,
    m: int,
    centre: float,
    width: float,
    dt: float,
    periodic: bool,
    most: float = np.inf,
    sparse: bool = False,
) -> tuple[_Fit | None, float]:
    """``_fit`` in the widest band that is no worse than the least, of up to ``most`` [rad/s], and
    how many times wider that is; None where the inputs are not told apart.
    """
    best, chosen = None, 1.0
    for wider in _WIDER:
        reach = wider * width / 2
        if best is not None and 2 * reach > most:
            break
        if wider > 1 and not reach < centre < 0.99 * np.pi / dt - reach:
            break
        fit = _fit(spectra, spans, m, centre, reach, periodic, sparse)
        if fit is None and best is not None:
            break
        if fit is None:  # lines that are excited may lie apart
            continue
        if best is not None and np.mean(np.diag(fit[1]).real / np.diag(best[1]).real) > _WORSE:
            break
        best, chosen = fit, wider
    return best, chosen


def _fit(
    spectra: list[np.ndarray],
    spans: np.ndarray,
    m: int,
    centre: float,
    reach: float,
    periodic: bool,
    sparse: bool,
) -> _Fit | None:
    """Response (p, m), noise (p, p), share (m, m) and coherence (p,) in centre -+ reach [rad/s];
    None: not told.
    """
    count = _DEGREE + 1
    rows, right = [], []
    for number, (Z, span) in enumerate(zip(spectra, spans, strict=True)):
        step = 2 * np.pi / span
        at = np.arange(int(np.ceil((centre - reach) / step)), int((centre + reach) / step) + 1)

        # columns: powers of the distance times the inputs, then the record's own transient
        powers = ((at * step - centre) / reach) ** np.arange(count)[:, None]
        X = np.zeros((len(at), count * (m + (0 if periodic else len(spectra)))), complex)
        X[:, : count * m] = (powers[:, None] * Z[:m, at]).reshape(-1, len(at)).T
        if not periodic:
            # the record's transient
            X[:, count * (m + number) : count * (m + number + 1)] = powers.T
        rows.append(X)
        right.append(Z[m:, at].T)
    X, Y = np.vstack(rows), np.vstack(right)
    size = np.linalg.norm(X, axis=0)
    if len(X) <= X.shape[1] or not size.all():
        return None
    power = np.sum(np.abs(X[:, :m] / size[:m]) ** 2, axis=1)
    spread = _lines_with_power(power)
    if spread < _SPREAD * count * m and not sparse:
        return None
    Q, R = np.linalg.qr(X / size)
    s = np.linalg.svd(R, compute_uv=False)
    if s[-1] <= _INDEPENDENT * s[0]:
        return None

    # at the centre only the power 0 counts: the first m rows of R^-1 Q', the pseudo-inverse
    back = np.linalg.inv(R)[:m] / size[:m, None]
    inside = Q.conj().T @ Y
    left = Y - Q @ inside
    if spread < _SPARSE * len(Y) and not sparse:
        # what a polynomial does not follow is seen where there is power, not beside it: there alone
        # noise is told, by rows of the weights w_i (1 - h_i) with the leverage h_i = |Q_i|^2
        leverage = np.sum(np.abs(Q) ** 2, axis=1)
        noise = (left.T * power) @ left.conj() / float(np.sum(power * (1 - leverage)))
    else:
        noise = left.T @ left.conj() / max(len(Y) - X.shape[1], 1)
    total = np.sum(np.abs(Y) ** 2, axis=0)
    coherence = 1 - np.sum(np.abs(left) ** 2, axis=0) / np.where(total > 0, total, 1.0)

    # G; noise of the outputs; (X'X)^-1 of these columns, conjugated: Cov G = noise (x) share
    return (
        (back @ inside).T,
        noise,
        back.conj() @ back.T,
        coherence,
    )


def _lines_with_power(power: np.ndarray) -> float:
    """Over how many lines of a band the inputs spread their power (k,), each taken over its own.

    A sequence that repeats has power at the multiples of its own frequency only; every axis' copy
    of it, shifted, has it at the same ones. Fewer of them than unknowns are fitted exactly, and
    what lies between tells nothing of the response, but makes the noise look small.
    """
    # of k equal ones k, of a single one 1
    return float(power.sum() ** 2 / np.sum(power**2))


def _spectra(record: Record, names: tuple[str, ...]) -> np.ndarray:
    """The spectra (signals, lines) of a record, means taken out."""
    rows = np.stack(signal_rows(record, names))
    return np.asarray(
        scipy.fft.rfft(rows - rows.mean(axis=1, keepdims=True), axis=1) / np.sqrt(rows.shape[1])
    )
