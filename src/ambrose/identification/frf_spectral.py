"""A frequency response by the local polynomial method: no window, no leakage, the resolution of the
whole record.

Around every line response and transient are polynomials of the line's number, fitted by least
squares over the lines beside it; what they leave is noise (Pintelon & Schoukens 2012, ch. 7). A
window smears a resonance and takes its leakage for noise; here both are of third order in the width
of the band.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from ambrose.core.checks import InvalidInput, as_several, invalid, same_clock
from ambrose.core.frequency import FrequencyResponse
from ambrose.core.statespace import Names, index_of
from ambrose.identification.findings import signal_rows
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.record.record import Record

# Frequency responses from records: averaged over windowed segments, open loop or closed loop, with
# what they are worth.
#
# In closed loop noise comes round through the controller into the plant's input, and the quotient
# S_yu/S_uu (H1) is drawn towards -1/K. The excitation e is not part of the loop's noise: G = S_ye
# S_ue^-1 (joint input-output method, e as instrument) is free of that bias. Both are one estimate
# here: responses T from e to outputs and inputs by least squares over all segments, G = T_y T_u^-1;
# H1 is the case e = u. Pintelon & Schoukens (2012), ch. 2; Bendat & Piersol (2010), ch. 9; Welch
# (1967).


WINDOWS = ("hann", "boxcar")
_EXCITED = 1e-4  # of the strongest line's power (-40 dB): weaker lines are left out
_BLOCK = 500_000  # samples of all signals cut at once
# least eigenvalue of the excitations' coherence matrix: below, they cannot be told apart
_INDEPENDENT = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Frf:
    """A measured transfer matrix: values (w, p, m) complex at omega (w,) [rad/s], units of outputs
    per unit of inputs.

    variance (w, p, m): E|error|^2 of every value, from what the segments leave unexplained, overlap
    allowed for; the error is circular: each of real and imaginary part has half of it. coherence
    (w, p): of every output with all excitations together, 0..1; input_coherence (w, m): the same of
    the inputs (1 for H1). freedom: degrees of freedom of the noise estimate. dt [s]: compare with a
    plant sampled at this rate, with a zero-order hold. noise (w, p, p), share (w, m, m), where they
    are known: E[dG_ij conj dG_kl] = noise_ik share_jl, of which ``variance`` is the diagonal.
    """

    values: np.ndarray
    omega: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    variance: np.ndarray
    coherence: np.ndarray
    input_coherence: np.ndarray
    freedom: float
    dt: float
    noise: np.ndarray | None = None
    share: np.ndarray | None = None

    @property
    def response(self) -> FrequencyResponse:
        """The values alone."""
        return FrequencyResponse(self.values, self.omega, self.inputs, self.outputs)

    def select(self, inputs: Names | None = None, outputs: Names | None = None) -> Frf:
        """The part between the named signals; None keeps all."""
        j = index_of(self.inputs if inputs is None else inputs, self.inputs, "input")
        i = index_of(self.outputs if outputs is None else outputs, self.outputs, "output")
        part = self.response.select(inputs, outputs)
        return replace(
            self,
            values=part.values,
            inputs=part.inputs,
            outputs=part.outputs,
            variance=self.variance[:, i][:, :, j],
            coherence=self.coherence[:, i],
            input_coherence=self.input_coherence[:, j],
            noise=None if self.noise is None else self.noise[:, i][:, :, i],
            share=None if self.share is None else self.share[:, j][:, :, j],
        )

    def between(self, low: float, high: float) -> Frf:
        """The lines from ``low`` to ``high`` [rad/s]; raises InvalidInput where there are none."""
        # a line at an end of the band is within, whatever its rounding
        kept = (self.omega >= low * (1 - 1e-9)) & (self.omega <= high * (1 + 1e-9))
        if not kept.any():
            has = f"{self.omega[0]:g} to {self.omega[-1]:g} rad/s"
            raise invalid("the band", f"{low:g} to {high:g} rad/s", f"within {has}", "move it")
        return self.at_lines(kept)

    def at_lines(self, kept: np.ndarray) -> Frf:
        """The lines that ``kept`` (w,) says, true or false for each."""
        return replace(
            self,
            values=self.values[kept],
            omega=self.omega[kept],
            variance=self.variance[kept],
            coherence=self.coherence[kept],
            input_coherence=self.input_coherence[kept],
            noise=None if self.noise is None else self.noise[kept],
            share=None if self.share is None else self.share[kept],
        )

    def radius(self, confidence: float = 0.95) -> np.ndarray:
        """Radius (w, p, m) of the circle around each value that holds the truth with this
        probability, noise alone.

        sd^2 F(2, 2 freedom): the ellipse of real and imaginary part, which is a circle here. Raises
        InvalidInput.
        """
        from scipy.special import fdtri

        if not 0 < confidence < 1:
            raise invalid("confidence", confidence, "between 0 and 1", "0.95 is usual")
        return np.sqrt(self.variance * float(fdtri(2, max(2 * self.freedom, 2.0), confidence)))


def h1(records: Record | Sequence[Record], inputs: Names, outputs: Names, **options: Any) -> Frf:
    """The response of ``outputs`` to ``inputs``, S_yu S_uu^-1 over all segments of all records: for
    inputs free of noise.

    With e_<axis> as inputs it gives closed-loop responses without bias; between signals inside the
    loop use ``closed_loop``, whose options these are. Raises InvalidInput.
    """
    return closed_loop(records, inputs, outputs, excitations=inputs, **options)


def closed_loop(
    records: Record | Sequence[Record],
    inputs: Names,
    outputs: Names,
    *,
    excitations: Names | None = None,
    segment: float = 0.5,
    overlap: float = 0.75,
    window: str = "hann",
    band: tuple[float, float] | None = None,
    harmonics: int = 3,
) -> Frf:
    """The response of ``outputs`` to ``inputs`` inside the loop, S_ye S_ue^-1: free of the bias
    that feedback gives H1.

    excitations: as many as inputs (None: those with the inputs' axes, e_A_zeta for v_A_zeta,
    u_A_zeta or i_A_zeta). The plant is closed_loop(records, ["v_A_zeta", ...], ["y_A_zeta", ...]).
    segment [s]: its length, 1/segment the distance of the lines; overlap: share of a segment that
    it has in common with the next; window "hann" or "boxcar" (periodic records only); band [rad/s]:
    lines kept (None: all that are excited). harmonics: multiples of the record's speed up to which
    unbalance and run-out are taken out of every signal. Several inputs need several records, or
    excitations that differ over the segments. A name v_<axis> [A] stands for u + e, the amplifier's
    command, where the record lacks it. Raises InvalidInput.
    """
    records, u, y = (as_several(given) for given in (records, inputs, outputs))
    e = tuple(f"e_{name.partition('_')[2]}" for name in u)
    if excitations is not None:
        e = as_several(excitations)
    # v_<axis> is made of u_<axis> and e_<axis> where the record lacks it
    needed = {
        *e,
        *u,
        *y,
        *(f"{kind}_{name[2:]}" for name in u if name[:2] == "v_" for kind in "ue"),
    }
    frames = _frames(
        tuple(without_synchronous(record, harmonics, needed) for record in records),
        segment,
        overlap,
        window,
    )
    if not e or not y or len(e) != len(u):
        raise invalid(
            "the number of excitations and inputs",
            (len(e), len(u)),
            "equal, with an output",
            "one per input",
        )
    m = len(u)
    names = (*e, *y) if u == e else (*e, *u, *y)
    powers, products, N = frames.sums(names, m)  # of all lines
    kept = _excited(powers[:m], frames.omega, band, e)
    omega = frames.omega[kept]
    powers = powers[:, kept]
    products = products[kept]
    N = N[kept]

    # T = S_.e S_ee^-1 of all signals, then G = T_y T_u^-1
    P = _inverse(products[:, :m], omega, e)
    T = products @ P
    # e alone: its response to itself is one
    T, total = (T, powers) if u == e else (T[:, m:], powers[m:])
    Tu, Ty = T[:, :m], T[:, m:]
    Tu_inverse = np.linalg.inv(Tu) if u != e else np.broadcast_to(np.eye(m), Tu.shape)
    G = Ty @ Tu_inverse
    K = sum(len(start) for start in frames.starts)
    unexplained, power = np.zeros(total.shape), np.zeros((len(y), len(omega)))
    # once more: the difference of sums of squares would lose clean records
    for _, block in frames.blocks(names):
        Z = block[:, :, kept].transpose(2, 0, 1)  # (w, signals, segments)
        residual = (Z if u == e else Z[:, m:]) - T @ Z[:, :m]
        unexplained += _squares(residual)
        power += _squares(residual[:, m:] - G @ residual[:, :m])  # what is left of y - G u

    # power of the noise: sum |r|^2 / (K - tr(P N)); of K segments of noise the regression on e
    # absorbs tr(P N), overlap allowed for, which for m excitations without overlap is m
    absorbed = np.einsum("wab,wab->w", P, N).real
    power = power.T / np.maximum(K - absorbed, 1e-9 * K)[:, None]

    # G errs by sum_k r_k E_k^H Q of the residuals r = y - G u, with Q = S_ee^-1 T_u^-1, so that
    # E|dG_ij|^2 = power_i (Q' N conj Q)_jj
    Q = P @ Tu_inverse
    share = np.einsum("wai,wab,wbi->wi", Q, N, Q.conj()).real
    coherence = 1 - unexplained.T / np.where(total.T > 0, total.T, 1.0)
    coherence = np.clip(np.where(total.T > 0, coherence, 0.0), 0.0, 1.0)
    return Frf(
        G,
        omega,
        u,
        y,
        power[:, :, None] * np.maximum(share, 0.0)[:, None, :],
        coherence[:, m:],
        coherence[:, :m],
        max(frames.independent - m, 1.0),
        records[0].dt,
    )


def _squares(values: np.ndarray) -> np.ndarray:
    """sum over the segments of |values|^2 (w, signals, segments), as (signals, w)."""
    return np.asarray(
        np.einsum("wsk,wsk->sw", values.real, values.real)
        + np.einsum("wsk,wsk->sw", values.imag, values.imag)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """How records are cut: first samples of every segment per record, window (L,), correlation of
    the window with itself.
    """

    records: tuple[Record, ...]
    starts: tuple[np.ndarray, ...]
    window: np.ndarray
    step: int
    dt: float

    @property
    def omega(self) -> np.ndarray:
        return 2 * np.pi * np.arange(len(self.window) // 2 + 1) / (len(self.window) * self.dt)

    @property
    def window_correlation(self) -> np.ndarray:
        """Correlation of the noise in segments 0, 1, 2 ... steps apart."""
        # rho_d = sum w(t) w(t + d step)/sum w^2
        w, L = self.window, len(self.window)
        return np.array([float(w[: L - d] @ w[d:]) for d in range(0, L, self.step)]) / float(w @ w)

    @property
    def independent(self) -> float:
        """How many segments without overlap would tell as much."""
        # K^2/(K + 2 sum (K - d) rho_d^2) per record (Welch)
        rho = self.window_correlation
        total = 0.0
        for start in self.starts:
            K = len(start)
            total += K**2 / (K + 2 * sum((K - d) * rho[d] ** 2 for d in range(1, min(len(rho), K))))
        return total

    def blocks(self, names: Sequence[str]) -> Iterator[tuple[bool, np.ndarray]]:
        """The windowed spectra (signals, segments, lines), some segments of one record at a time,
        and whether it is a new one.

        The mean over a record is taken out first.
        """
        L = len(self.window)
        count = max(1, _BLOCK // (len(names) * L))
        for record, starts in zip(self.records, self.starts, strict=True):
            rows = [_signal(record, name) for name in names]
            means = [row.mean() for row in rows]
            for first in range(0, len(starts), count):
                chosen = starts[first : first + count]
                block = np.empty((len(names), len(chosen), L // 2 + 1), complex)
                for part, row, mean in zip(block, rows, means, strict=True):
                    cut = np.lib.stride_tricks.sliding_window_view(row, L)[chosen]
                    part[:] = scipy.fft.rfft((cut - mean) * self.window, axis=1)
                yield first == 0, block

    def sums(self, names: Sequence[str], m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Over all segments, at every line: powers (signals, w), products with the first m signals
        (w, signals, m), and sum over segments j, k of R_jk conj(E_j) E_k' (w, m, m) of these; R:
        correlation of white noise in segments j and k.
        """
        lines = len(self.omega)
        n = len(names)
        rho = self.window_correlation
        powers = np.zeros((n, lines))
        products = np.zeros((lines, n, m), complex)
        N = np.zeros((lines, m, m), complex)
        last: list[np.ndarray] = []  # the segments before, (w, m) each
        for new, block in self.blocks(names):
            Z = np.ascontiguousarray(block.transpose(2, 0, 1))
            powers += _squares(Z)
            E = Z[:, :m]
            products += Z @ E.conj().swapaxes(1, 2)
            N += E.conj() @ E.swapaxes(1, 2)

            # segments of different records are not correlated; this record's earlier ones are kept
            last = [] if new else last
            E = np.concatenate([*(item[:, :, None] for item in last), E], axis=2)
            for d in range(1, min(len(rho), E.shape[2])):
                if rho[d] > 0:
                    later = max(len(last), d)  # pairs whose later one is in this block
                    pair = E[:, :, later - d : E.shape[2] - d].conj() @ E[:, :, later:].swapaxes(
                        1, 2
                    )
                    # t_j - t_k
                    pair *= (rho[d] * np.exp(-1j * self.omega * d * self.step * self.dt))[
                        :, None, None
                    ]
                    N += pair + pair.conj().swapaxes(1, 2)
            last = [E[:, :, k] for k in range(max(0, E.shape[2] - len(rho) + 1), E.shape[2])]
        return powers, products, N


def _frames(records: tuple[Record, ...], segment: float, overlap: float, window: str) -> _Frames:
    if not records:
        raise InvalidInput("no record was given; a frequency response needs at least one")
    dt = records[0].dt
    for number, record in enumerate(records, 1):
        if not same_clock(record.dt, dt):
            have = f"{record.sample_rate_hz:g} Hz"
            raise invalid(
                f"the sample rate of record {number}",
                have,
                f"{1 / dt:g} Hz, that of the first",
                "take equal rates",
            )
    if window not in WINDOWS:
        raise invalid(
            "window",
            repr(window),
            " or ".join(WINDOWS),
            "hann, unless the record is periodic in the segment",
        )
    if not 0 <= overlap <= 0.95:
        raise invalid("overlap", overlap, "from 0 to 0.95", "0.75 is usual with a Hann window")
    L = round(segment / dt) if np.isfinite(segment) else 0
    shortest = min(record.values.shape[1] for record in records)
    if not 8 <= L <= shortest:
        requirement = f"from {8 * dt:g} to {shortest * dt:g} s, the shortest record"
        raise invalid("segment", f"{segment:g} s", requirement, "shorten it, or record longer")
    step = max(1, round(L * (1 - overlap)))
    starts = tuple(np.arange(0, record.values.shape[1] - L + 1, step) for record in records)
    shape = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(L) / L) if window == "hann" else np.ones(L)
    return _Frames(records, starts, shape, step, dt)


def _signal(record: Record, name: str) -> np.ndarray:
    """A signal, u + e of an axis for v_<axis>, nothing for an excitation that this record does not
    drive.
    """
    kind, _, axis = name.partition("_")
    if kind == "v" and name not in record.signals:
        command, excitation = signal_rows(record, [f"u_{axis}", f"e_{axis}"])
        return command + excitation
    return signal_rows(record, [name])[0]


def _excited(
    power: np.ndarray, omega: np.ndarray, band: tuple[float, float] | None, names: tuple[str, ...]
) -> np.ndarray:
    """The lines (w,) bool that every excitation, of power (m, w), reaches within the band."""
    for name, row in zip(names, power, strict=True):
        if not row.any():
            raise InvalidInput(
                f"the excitation {name} never changes in these records; excite it, or leave its "
                "input out"
            )
    strong = (power > _EXCITED * power.max(axis=1, keepdims=True)).all(axis=0)
    low, high = (0.0, np.inf) if band is None else band
    # lines 0 and 1 hold the mean and drift that the window spreads; the last is the Nyquist
    # frequency, where a spectrum is real
    kept = (
        (omega >= max(low, 1.5 * omega[1]) * (1 - 1e-9))
        & (omega <= high * (1 + 1e-9))
        & (omega < omega[-1])
    )
    if not (kept & strong).any():
        where = "anywhere" if band is None else f"between {low:g} and {high:g} rad/s"
        raise InvalidInput(
            f"the excitations {', '.join(names)} have no power {where}; move the band, or "
            "excite there"
        )
    return kept & strong


def _inverse(S: np.ndarray, omega: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """S^-1 (w, m, m) of the excitations' spectra, after checking that they differ at every line."""
    size = np.sqrt(np.einsum("waa->wa", S).real)
    coherence = S / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(coherence)
    worst = int(np.argmin(values[:, 0]))  # the line with the least eigenvalue
    if values[worst, 0] < _INDEPENDENT:
        together = [
            name
            for name, part in zip(names, np.abs(vectors[worst, :, 0]), strict=True)
            if part > 0.1
        ]
        raise InvalidInput(
            f"the excitations {', '.join(together)} are the same at {omega[worst]:.4g} rad/s, so "
            "their responses cannot be separated; add a record with another pattern (parallel "
            "and tilt, or each axis alone), or "
            "take fewer inputs"
        )
    return np.linalg.inv(S)


_DEGREE = 2  # of the local polynomial (Pintelon & Schoukens 2012, ch. 7)
_INDEPENDENT_LOCAL = 1e-5  # least singular value of the lines' matrix, columns of unit length
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
    records, u, y = (as_several(given) for given in (records, inputs, outputs))
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
            f"the excitations {', '.join(u)} are equal, or have no power in the band; excite "
            "each with a different pattern"
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
    if s[-1] <= _INDEPENDENT_LOCAL * s[0]:
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
