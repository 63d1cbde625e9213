"""What turns with the rotor, and other tones: cos and sin of 1 to 3 times the angle, which a fit
takes out of every signal.

Unbalance, run-out and mains enter every signal linearly, with an amplitude and a phase of their own
in each. So they are nuisances like offsets (output_error/normal_equations.py): eliminated at every
theta, neither filtered nor modelled, and what they hide of the excitation is missing in J'J, hence
in the standard deviations. Only the angle is not linear: where the speed is known nearly, the angle
is the one under which most of the residual turns with the rotor.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from ambrose.core.checks import check_positive, invalid
from ambrose.record.record import Record

_NEARLY = 0.02  # of the stated speed, within which the true one is looked for; assumed
_CLEAR = 20.0  # power of the lines over what noise makes of it, from which they tell the speed
_BLOCKS, _PAD = (64, 8192), 16  # blocks, least and most; factor of zero padding
_PIECE = 65_536  # samples at a time
_TOLD = 1e-3  # rad: a smaller change of the angle is none
_TOLD_APART = 0.1  # of a cycle over the record: by less, two waves are one
# power of an excitation's line over that beside it, and of the excitation's own
_LINE, _SHARE = 30.0, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Synchronous:
    """The waves of a record: cos and sin of ``orders`` times the angle, which is rate base + drift
    base^2 [rad], and of ``tones`` [rad/sample]. base (k,): the integral of the recorded speed over
    its mean (None: the number of the sample); first: number of the record's sample that is the
    first one here.
    """

    rate: float
    orders: tuple[int, ...]
    tones: tuple[float, ...] = ()
    drift: float = 0.0
    base: np.ndarray | None = None
    first: int = 0

    @property
    def count(self) -> int:
        """How many waves there are."""
        return 2 * (len(self.orders) + len(self.tones))

    def _base(self, start: int, stop: int) -> np.ndarray:
        """``base`` of the samples start to stop - 1, counted from the first one here."""
        inside = slice(self.first + start, self.first + stop)
        return (
            np.arange(inside.start, inside.stop, dtype=float)
            if self.base is None
            else self.base[inside]
        )

    def _angle(self, base: np.ndarray) -> np.ndarray:
        """The rotor's angle [rad]."""
        return np.asarray(self.rate * base + self.drift * base**2)

    def _turning(self, base: np.ndarray) -> np.ndarray:
        """e^(j angle)."""
        return np.asarray(np.exp(1j * self._angle(base)))

    def waves(self, start: int, stop: int) -> np.ndarray:
        """Samples of the waves (count, length): cos and sin of each order, then of each tone."""
        turns: list[np.ndarray] = []
        if self.orders:
            one = self._turning(self._base(start, stop))
            turns += [one**n for n in self.orders]
        samples = np.arange(self.first + start, self.first + stop)
        turns += [np.exp(1j * tone * samples) for tone in self.tones]
        return np.array([part for turn in turns for part in (turn.real, turn.imag)]).reshape(
            self.count, stop - start
        )

    def frequencies(self, samples: int) -> np.ndarray:
        """Of the orders, as means over the ``samples``, and of the tones [rad/sample]."""
        first, last = self._angle(self._base(0, samples)[[0, -1]])
        speed = (last - first) / max(samples - 1, 1)
        return np.array([*(n * speed for n in self.orders), *self.tones])

    def differs(self, other: Synchronous, samples: int) -> bool:
        """Whether the angle of the other one, but for a constant, is another by more than _TOLD."""
        base = self._base(0, samples)[:: max(samples // 64, 1)]
        change = self._angle(base) - other._angle(base)
        return float(np.ptp(change)) > _TOLD

    def refined(self, pieces: Iterable[np.ndarray], samples: int) -> Synchronous | None:
        """The same with the angle, quadratic about the one that was stated, under which most power
        of the signals (p, length), piece by piece, turns with the rotor; None where that is no more
        than noise has.
        """
        from scipy.optimize import minimize

        if not self.orders or samples < 2 * _BLOCKS[0]:
            return None
        low, high = self._base(0, samples)[[0, -1]]
        half = (high - low) / 2
        cycles = abs(self.rate) * 2 * half / (2 * np.pi)
        M = int(np.clip(8 * _NEARLY * max(self.orders) * cycles, *_BLOCKS))

        # M block sums, each turned back by the stated angle: what is left varies slowly
        z = self._demodulated(pieces, low, high, M)
        s = (np.arange(M) + 0.5) * 2 / M - 1  # the angle gains a s + c s^2 over the record
        n = np.array(self.orders)[:, None, None]
        noise = float(np.sum(np.abs(z) ** 2))
        if noise == 0:
            return None

        # sum |sum z e^(-j n (a s + c s^2))|^2 over sum |z|^2: about 1 where z is noise
        def lost(x: np.ndarray) -> float:
            return (
                -float(
                    np.sum(
                        np.abs(np.sum(z * np.exp(-1j * n * (x[0] * s + x[1] * s**2)), axis=2)) ** 2
                    )
                )
                / noise
            )

        # First c = 0: a s is a line of the padded transform, a = pi i / _PAD, n i for the order n.
        power = np.sum(np.abs(scipy.fft.fft(z, _PAD * M, axis=2)) ** 2, axis=1)
        reach = max(int(np.ceil(_NEARLY * abs(self.rate) * half * _PAD / np.pi)), 1)
        trials = np.arange(-reach, reach + 1)
        total = sum(power[j, (order * trials) % (_PAD * M)] for j, order in enumerate(self.orders))
        begin = np.array([np.pi / _PAD * trials[int(np.argmax(total))], 0.0])

        # Then a and c together, from one bin about the best line.
        simplex = begin + np.array([[0.0, 0.0], [np.pi / _PAD, 0.0], [0.0, np.pi / _PAD]])
        optimum = minimize(
            lost,
            begin,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-9},
        )
        return None if -optimum.fun < _CLEAR else self.turned(optimum.x, samples)

    def turned(self, change: np.ndarray, samples: int) -> Synchronous:
        """The angle gains a s + c s^2, s from -1 to 1 over the record; but for a constant, which is
        none.
        """
        low, high = self._base(0, samples)[[0, -1]]
        half = (high - low) / 2
        middle = (low + high) / 2
        a, c = change

        # s = (base - middle)/half: a s + c s^2 =
        # (a/half - 2 c middle/half^2) base + c/half^2 base^2 + a constant
        rate, drift = self.rate + a / half - 2 * c * middle / half**2, self.drift + c / half**2
        return replace(self, rate=float(rate), drift=float(drift))

    def slopes(self, start: int, stop: int, b: np.ndarray, samples: int) -> np.ndarray:
        """By how much signals of the amplitudes b (p, count) follow the two coefficients of
        ``turned`` (2, p, length).
        """
        low, high = self._base(0, samples)[[0, -1]]

        # tones do not follow the rotor's angle: n = 0
        n = np.repeat([*self.orders, *(0 for _ in self.tones)], 2)
        # of a cos + b sin: b cos - a sin
        slope = (n * b).reshape(len(b), -1, 2)[:, :, ::-1] * [1.0, -1.0]
        s = (self._base(start, stop) - low) * 2 / (high - low) - 1
        return np.asarray(
            (slope.reshape(b.shape) @ self.waves(start, stop)) * np.stack([s, s**2])[:, None]
        )

    def _demodulated(
        self, pieces: Iterable[np.ndarray], low: float, high: float, M: int
    ) -> np.ndarray:
        """Sums (orders, p, M) over M blocks of the signals turned back by every order."""
        z, start = np.zeros((0, 0, 0), complex), 0
        for piece in pieces:
            if not start:
                z = np.zeros((len(self.orders), len(piece), M), complex)
            base = self._base(start, start + piece.shape[1])

            # z = sum over a block of x e^(-j n angle); block edges by the angle's base, not by time
            block = np.minimum(((base - low) / (high - low) * M).astype(int), M - 1)
            edges = np.flatnonzero(np.r_[True, np.diff(block) > 0])
            one = self._turning(base).conj()
            for j, order in enumerate(self.orders):
                z[j, :, block[edges]] += np.add.reduceat(piece * one**order, edges, axis=1).T
            start += piece.shape[1]
        return z

    def coinciding(self, signal: np.ndarray) -> tuple[int, ...]:
        """The orders at which a signal (k,) has a line: far more there than beside it."""
        low, high = self._base(0, len(signal))[[0, -1]]
        if not self.orders or high <= low or len(signal) < 2 * _BLOCKS[0]:
            return ()
        z = self._demodulated([(signal - signal.mean())[None]], low, high, _BLOCKS[0])[:, 0]

        # cycles over the record off the order; 1 and 2 are its own leakage
        beside = np.abs(scipy.fft.fft(z, axis=1)[:, [-5, -4, -3, 0, 3, 4, 5]]) ** 2

        # the line of a sine that were the whole signal: (k A/2)^2 = k^2 var/2
        whole = len(signal) * float(np.var(signal)) * len(signal) / 2
        at_line, around = beside[:, 3], beside[:, [0, 1, 2, 4, 5, 6]].mean(axis=1)
        driven = (at_line > _LINE * around) & (at_line > _SHARE * whole)
        return tuple(
            order for order, coincides in zip(self.orders, driven, strict=True) if coincides
        )


def synchronous_of(
    record: Record, harmonics: int = 3, tones: Sequence[float] | float = ()
) -> Synchronous | None:
    """What may turn with the rotor in a record: 1 to ``harmonics`` times the angle, by its channel
    speed [rad/s] or the speed of its point, and the tones [Hz]; None: nothing. Raises InvalidInput.
    """
    if (
        isinstance(harmonics, bool)
        or not isinstance(harmonics, int | np.integer)
        or not 0 <= harmonics <= 20
    ):
        raise invalid("harmonics", repr(harmonics), "a whole number, 0 to 20", "3 is usual")
    tones = (tones,) if isinstance(tones, int | float) else tones
    ways = tuple(
        2 * np.pi * check_positive(tone, "a tone", "give its frequency in Hz") * record.dt
        for tone in tones
    )
    if any(way >= np.pi for way in ways):
        raise invalid(
            "a tone",
            f"{max(tones):g} Hz",
            f"below half the sample rate, {0.5 / record.dt:g} Hz",
            "give its alias",
        )
    rate, base = abs(record.point.speed) * record.dt, None
    if "speed" in record.signals and record["speed"].any():
        speed = np.abs(record["speed"])
        rate, base = float(speed.mean()) * record.dt, np.cumsum(speed) / speed.mean()
    orders = tuple(range(1, harmonics + 1)) if rate else ()
    near = 2 * np.pi * _TOLD_APART / record.values.shape[1]
    known = [order * rate for order in orders]
    for number, way in enumerate(ways):
        if any(abs(way - other) < near for other in (*known, *ways[:number])):
            required = (
                "neither another tone nor a multiple of the speed, to a tenth of a cycle over the "
                "record"
            )
            raise invalid(
                "a tone",
                f"{tones[number]:g} Hz",
                required,
                "leave it out: what turns with the rotor is taken out anyway",
            )
    return Synchronous(rate, orders, ways, base=base) if orders or ways else None


def without_synchronous(
    record: Record, harmonics: int = 3, names: Collection[str] | None = None
) -> Record:
    """The record less what turns with the rotor, in every signal and its excitations: responses to
    the excitation stay as they are, but where an excitation's line is a multiple of the speed.
    names: signals that are enough (None: all); a record in which nothing turns is given back as it
    is.
    """
    turning = synchronous_of(record, harmonics)
    if turning is None:
        return record
    k = record.values.shape[1]
    parts = [slice(start, min(start + _PIECE, k)) for start in range(0, k, _PIECE)]
    measured = [
        row
        for name, row in zip(record.signals, record.values, strict=True)
        if name[:2] in {"y_", "ep"} and np.ptp(row)
    ]
    if measured:
        sizes = [(row, row.mean(), row.std()) for row in measured]
        y = (np.array([(row[part] - mean) / size for row, mean, size in sizes]) for part in parts)
        turning = turning.refined(y, k) or turning
    kept = [i for i, name in enumerate(record.signals) if names is None or name in names]
    values = record.values[kept]
    # displacements, currents, forces and excitations along directions: not speed, p_ and d_
    moving = [
        j
        for j, i in enumerate(kept)
        if record.signals[i][:2] in {"y_", "u_", "i_", "e_", "v_", "f_", "ep", "al"}
    ]

    # least squares of every moving signal on the constant and the waves; the constant stays in
    square, product = (
        np.zeros((1 + turning.count, 1 + turning.count)),
        np.zeros((1 + turning.count, len(moving))),
    )
    for part in parts:
        W = np.vstack([np.ones(part.stop - part.start), turning.waves(part.start, part.stop)])
        square, product = square + W @ W.T, product + W @ values[moving, part].T
    amplitudes = np.linalg.lstsq(square, product)[0][1:].T
    for part in parts:
        values[moving, part] -= amplitudes @ turning.waves(part.start, part.stop)
    values.flags.writeable = False  # or the record would copy it
    signals, units = (tuple(of[i] for i in kept) for of in (record.signals, record.units))
    return replace(record, signals=signals, units=units, values=values)
