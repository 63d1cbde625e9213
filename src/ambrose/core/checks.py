"""Argument checks and the package's exceptions.

A shape is written the same way in a docstring, in a check and in the message: ``"(n, n)"``. Letters
that repeat within one check must agree; numbers are literal; ``...`` stands for any leading axes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_LONGEST = 300  # characters of a value in a message

SAME_CLOCK = 1e-4  # by which two sample times may differ, relatively


class AmbroseError(Exception):
    """Anything this package refuses or fails to do; the message names quantity, value and
    remedy.
    """


class InvalidInput(AmbroseError, ValueError):
    """The caller's data violates a stated requirement."""


class NumericalFailure(AmbroseError, ArithmeticError):
    """A computation did not reach its stated accuracy; nothing unverified is returned."""


class UnstableSystem(AmbroseError, ValueError):
    """A quantity was asked for that exists only for a stable system."""


def invalid(name: str, value: object, requirement: str, remedy: str) -> InvalidInput:
    """The one form of a complaint: what it is, what it was, what it must be, what to do."""
    text = str(value)
    given = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 10]} ..."
    return InvalidInput(f"{name} is {given}, but must be {requirement}; {remedy}")


@contextmanager
def named_failure(what: str) -> Iterator[None]:
    """Around (or as the decorator of) a computation: a factorisation that LAPACK refuses, for a
    singular matrix or numbers that overflowed on the way, an overflow or a division by zero ends in
    a NumericalFailure that says ``what`` was being computed.
    """
    try:
        yield
    except AmbroseError:
        raise
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        # LinAlgError is a ValueError; scipy refuses infinite entries with a plain one. numpy's
        # warnings are errors where the command line, or a caller, made them so
        plain = isinstance(error, ValueError) and not isinstance(error, np.linalg.LinAlgError)
        if plain and "infs or NaNs" not in str(error):
            raise
        raise NumericalFailure(
            f"{what} cannot be computed to any accuracy: a number overflows on the way, or a "
            "matrix is singular to rounding; look for a number with a wrong unit or exponent, or "
            "for poles or modes that coincide"
        ) from error


def memberwise(function: Callable[..., np.ndarray], *stacks: np.ndarray) -> np.ndarray:
    """A numpy.linalg ``function`` of stacks of matrices (b, n, n), with a result of the shape of
    the last stack.

    A member that is refused (singular, not definite) is NaN, and does not take the others with it.
    """
    try:
        return function(*stacks)
    except np.linalg.LinAlgError:
        result = np.full(stacks[-1].shape, np.nan, np.result_type(*stacks, float))
        for i, members in enumerate(zip(*stacks, strict=True)):
            with suppress(np.linalg.LinAlgError):
                result[i] = function(*members)
        return result


def check_finite(x: ArrayLike, name: str) -> np.ndarray:
    """``x`` as an array of floats (or complex), after refusing NaN and infinity.

    Raises InvalidInput with the first offending index.
    """
    try:
        array = np.asarray(x)
        if array.dtype.kind in "USmM":
            raise TypeError(f"it holds {array.dtype}")
        if array.dtype.kind not in "fc":
            array = array.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(
            f"{name} is not numeric ({error}); give a rectangular array of numbers"
        ) from error
    bad = ~np.isfinite(array)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        where = f"{name}{list(index)}" if index else name
        given = np.asarray(x)[index]  # None became NaN
        raise invalid(
            where, given, "finite", "look for a missing value or a division by zero upstream"
        )
    return array


def same_clock(one: float, other: float) -> bool:
    """Whether two sample times [s], or two rates, are those of one clock: to 100 parts per million.

    Crystals are off by tens of ppm, and a rate is written with few digits (66.667 us for 15 kHz: 5
    ppm).
    """
    return abs(one - other) <= SAME_CLOCK * abs(other)


def check_path(path: Any, what: str) -> Path:
    """``path`` as a Path. Raises InvalidInput for what is none, as a number or an object given by
    mistake.
    """
    if not isinstance(path, str | os.PathLike):
        raise invalid(
            f"the path of the {what}",
            type(path).__name__,
            "a text or a Path",
            "give the name of a file",
        )
    if "\0" in str(path):
        raise invalid(
            f"the path of the {what}",
            repr(str(path)),
            "free of null characters",
            "give the name of a file",
        )
    return Path(path)


def check_shape(x: ArrayLike, name: str, shape: str, **sizes: int) -> np.ndarray:
    """``x`` as a finite array, after checking its shape against a string such as ``"(n, m)"``.

    ``sizes`` fixes letters, e.g. ``check_shape(B, "B", "(n, m)", n=4)``. Raises InvalidInput.
    """
    array = check_finite(x, name)
    if not match_shape(array.shape, shape, dict(sizes)):
        known = "".join(f", {letter} = {size}" for letter, size in sizes.items())
        raise invalid(
            f"the shape of {name}",
            array.shape,
            f"{shape}{known}",
            "check the order and number of its axes",
        )
    return array


def match_shape(actual: tuple[int, ...], shape: str, sizes: dict[str, int]) -> bool:
    """Whether ``actual`` fits ``shape``; letters seen for the first time are entered into
    ``sizes``.
    """
    wanted = _letters(shape)
    if wanted and wanted[0] == "...":
        wanted = wanted[1:]
        actual = actual[max(0, len(actual) - len(wanted)) :]
    if len(wanted) != len(actual):
        return False
    for letter, size in zip(wanted, actual, strict=True):
        if letter.isdigit():
            if int(letter) != size:
                return False
        elif letter.isidentifier() and sizes.setdefault(letter, size) != size:
            return False
    return True


@cache
def _letters(shape: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in shape.strip("() ").split(",") if part.strip())


def check_positive(x: Any, name: str, remedy: str, *, zero_allowed: bool = False) -> float:
    """``x`` as a float, after refusing NaN, infinity and numbers below (or at) zero. Raises
    InvalidInput.
    """
    if isinstance(x, str):
        raise invalid(name, repr(x), "a number", remedy)
    array = check_finite(x, name)
    if array.ndim or np.iscomplexobj(array):
        raise invalid(
            name,
            array.tolist() if array.size < 5 else f"of shape {array.shape}",
            "one real number",
            remedy,
        )
    value = float(array)
    if value < 0 or (value == 0 and not zero_allowed):
        raise invalid(name, value, "zero or positive" if zero_allowed else "positive", remedy)
    return value
