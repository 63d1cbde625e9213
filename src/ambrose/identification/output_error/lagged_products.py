"""Sums over products of signals some samples apart, from records that are only seen piece by piece.

Overlap-save: each piece is transformed together with the ``span`` samples before it, so that every
pair of samples at most ``span`` apart meets exactly once and the memory does not grow with the
record. What output_error/statistics.py does on whole records is the oracle in the tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

_BAND = 512  # frequencies


@dataclass(frozen=True, slots=True, eq=False)
class LaggedSums:
    """values (pairs, span + 1): sum over t of a(t) b(t - lag) for each pair (a, b) of the c
    signals; total (c,) their sums, squares (c,) those of their squares; head, tail (c, span): the
    first samples and the last; samples: how many there were.
    """

    pairs: tuple[tuple[int, int], ...]
    values: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    head: np.ndarray
    tail: np.ndarray
    samples: int

    def about_the_means(self, a: int, b: int) -> np.ndarray:
        """The sums (span + 1,) for signals a and b less their means."""
        lag, k = np.arange(self.values.shape[1]), self.samples
        mean_a, mean_b = self.total[a] / k, self.total[b] / k
        # of a: the samples that have no partner
        early = np.concatenate([[0.0], np.cumsum(self.head[a])])
        late = np.concatenate([[0.0], np.cumsum(self.tail[b][::-1])])
        sums = self.values[self.pairs.index((a, b))]

        # sum (a - ma)(b' - mb) = sum a b' - mb sum a - ma sum b' + (k - lag) ma mb
        crossed = mean_b * (self.total[a] - early[lag]) + mean_a * (self.total[b] - late[lag])
        return np.asarray(sums - crossed + (k - lag) * mean_a * mean_b)


def lagged_sums(
    pieces: Iterable[np.ndarray], pairs: Sequence[tuple[int, int]], span: int
) -> LaggedSums:
    """The sums over pieces (c, any length) of c signals for lags 0 to ``span``."""
    size = 0
    spectra = np.zeros(0)
    joined = np.zeros((0, 0))
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    total = squares = np.zeros(0)
    head, samples = np.zeros((0, 0)), 0
    values = np.zeros((len(pairs), span + 1))
    for piece in pieces:
        c, length = piece.shape
        if not samples:
            total = np.zeros(c)
            squares = np.zeros(c)
            joined = np.zeros((c, span))
            head = np.zeros((c, 0))
        needed = scipy.fft.next_fast_len(span + length, real=True)
        if needed > size:  # the first piece, unless a longer one follows
            if size:
                values += scipy.fft.irfft(spectra, size, axis=1)[:, : span + 1]
            size, spectra = needed, np.zeros((len(pairs), needed // 2 + 1), complex)

        # new samples against themselves and the ``span`` before: every pair once
        whole = np.concatenate([joined, piece], axis=1)
        new = whole.copy()
        new[:, :span] = 0.0
        N, W = scipy.fft.rfft(new, size, axis=1), scipy.fft.rfft(whole, size, axis=1)
        for row, (a, b) in enumerate(zip(first, second, strict=True)):
            spectra[row] += N[a] * W[b].conj()
        total += piece.sum(axis=1)
        squares += np.einsum("ct,ct->c", piece, piece)
        if head.shape[1] < span:
            head = np.concatenate([head, piece[:, : span - head.shape[1]]], axis=1)
        joined = whole[:, whole.shape[1] - span :]
        samples += length
    values += scipy.fft.irfft(spectra, size, axis=1)[:, : span + 1]
    return LaggedSums(tuple(pairs), values, total, squares, head, joined, samples)


def coloured_products(pieces: Iterable[np.ndarray], covariance: np.ndarray) -> np.ndarray:
    """sum over t and s of J_t' Gamma(t - s) J_s (q, q) for pieces of J (q, p, any length).

    covariance (p, p, span + 1): Gamma_ij at the lags 0 to span; Gamma_ij(-l) = Gamma_ji(l), and
    zero beyond. All pieces but the last are equally long.
    """
    p, _, longest = covariance.shape
    span = longest - 1
    size = 0
    q = 0
    kernel = np.zeros(0)
    result = np.zeros((0, 0))
    whole = np.zeros((0, p, 0))
    half = covariance.copy()
    half[:, :, 0] /= 2  # one side of the sum, of which the other is the transpose
    for piece in pieces:
        length = piece.shape[2]
        if not size:
            q, size = len(piece), scipy.fft.next_fast_len(span + length, real=True)
            kernel = scipy.fft.rfft(half, size, axis=2)
            result = np.zeros((q, q))
            whole = np.zeros((q, p, size))
            # the frequencies that stand for their negatives too
            kernel[:, :, 1 : (size + 1) // 2] *= 2
            # the piece begins ``span`` samples later
            kernel *= np.exp(2j * np.pi * span / size * np.arange(kernel.shape[2]))

        # mixed(t) = sum over l = 0..span of Gamma(l) J(t - l), result += sum over t of J_t' mixed_t
        whole[:, :, span : span + length] = piece
        whole[:, :, span + length :] = 0.0
        W, N = scipy.fft.rfft(whole, axis=2), scipy.fft.rfft(piece, size, axis=2)
        # few enough frequencies at a time to stay in the cache
        for start in range(0, W.shape[2], _BAND):
            band = slice(start, start + _BAND)
            part = np.ascontiguousarray(W[:, :, band])
            mixed = np.zeros_like(part)
            for i in range(p):
                for j in range(p):
                    mixed[:, i] += kernel[i, j, band] * part[:, j]
            result += np.real(N[:, :, band].conj().reshape(q, -1) @ mixed.reshape(q, -1).T) / size

        # the last ``span`` samples go before the next piece
        whole[:, :, :span] = whole[:, :, length : span + length].copy()
    return result + result.T
