"""Argument checks and the package's exceptions.

A shape is written the same way in a docstring, in a check and in the message: ``"(n, n)"``. Letters
that repeat within one check must agree; numbers are literal; ``...`` stands for any leading axes.
"""

import inspect
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

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


def as_several(given: Any) -> tuple[Any, ...]:
    """One or several, as a tuple: a text, a path, and whatever cannot be gone through is one."""
    alone = isinstance(given, str | os.PathLike) or not isinstance(given, Iterable)
    return (given,) if alone else tuple(given)


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


# Arguments of a wrong type, told from the annotations: a refusal in one sentence where Python would
# end in a traceback.
#
# While all goes well nothing is looked at. Where a call ends in an error that is none of ours, its
# arguments are held against the annotations, and the first that cannot be meant is named. Where all
# fit, the error is a defect, and stays.


Function = TypeVar("Function", bound=Callable[..., Any])
# where within the argument, what stands there, the annotation that it misses
Misfit = tuple[str, object, Any]
# annotation -> kinds of numpy scalars
_NUMBERS = {int: "iu", float: "iuf", complex: "iufc", bool: "b"}
_WORDS = {
    str: "a text",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    complex: "a number",
    NoneType: "None",
    os.PathLike: "a path",
    np.ndarray: "an array",
}


def names_wrong_types(function: Function) -> Function:
    """Decorator: a call that fails for an argument of a wrong type raises InvalidInput, which names
    it.

    On ``__post_init__`` it looks at the fields of the dataclass.
    """

    @wraps(function)
    def named(*args: Any, **keywords: Any) -> Any:
        return _named(named, function, args, keywords)

    return named  # type: ignore[return-value]


def _named(
    shown: Callable[..., Any],
    function: Callable[..., Any],
    args: tuple[Any, ...],
    keywords: Mapping[str, Any],
) -> Any:
    """The call of a function; where it fails, an argument of a wrong type is named. shown: the
    function as callers know it.
    """
    try:
        return function(*args, **keywords)
    except AmbroseError:
        raise
    except (TypeError, AttributeError, ValueError, LookupError, OverflowError) as error:
        check_types(shown, args, keywords, error)
        raise


def checks_plain_types(function: Function) -> Function:
    """Decorator: ``names_wrong_types``, and flags and counts are looked at before the call.

    A wrong one of these ends in no error: "no" is as good as True, and -3 repetitions are none. So
    an argument (on ``__post_init__`` a field of the dataclass) whose annotation is made of bool,
    int and None alone is checked at once.
    """

    signature = inspect.signature(function)

    @wraps(function)
    def checked(*args: Any, **keywords: Any) -> Any:
        with suppress(TypeError):  # Python's own message says which argument is missing or unknown
            values = signature.bind(*args, **keywords).arguments
            for name, hint in _plain_hints(function):
                if name in values and (misfit := _misfit(values[name], hint)) is not None:
                    raise _wrong(name, misfit, checked.__name__)
        return _named(checked, function, args, keywords)

    return checked  # type: ignore[return-value]


def check_plain_fields(item: Any) -> None:
    """The same for the fields of a dataclass, from its ``__post_init__``. Raises InvalidInput."""
    for name, hint in _plain_hints(type(item)):  # type: ignore[arg-type]
        if (misfit := _misfit(getattr(item, name), hint)) is not None:
            raise _wrong(name, misfit, type(item).__name__)


def _wrong(name: str, misfit: Misfit, owner: str) -> InvalidInput:
    place, wrong, wanted = misfit
    return InvalidInput(
        f"{name}{place} is {_shown(wrong)}, but must be {_words(wanted)}; see help({owner})"
    )


@cache
def _plain_hints(function: Callable[..., Any]) -> tuple[tuple[str, Any], ...]:
    """The arguments of a function, or the fields of a dataclass, whose annotation is made of bool,
    int and None alone.
    """
    module, hints = inspect.unwrap(function).__module__, []
    for name, parameter in inspect.signature(function).parameters.items():
        words = str(parameter.annotation).replace("|", " ").split()
        if words and not set(words) - {"bool", "int", "None"}:
            hints.append((name, _evaluated(parameter.annotation, module)))
    return tuple(hints)


def check_types(
    function: Callable[..., Any],
    args: tuple[Any, ...],
    keywords: Mapping[str, Any],
    cause: Exception | None = None,
) -> None:
    """Raises InvalidInput for the first argument that its annotation does not allow."""
    owner = (
        type(args[0]).__name__ if args and function.__name__.startswith("__") else function.__name__
    )
    for name, value, hint in _annotated(function, args, keywords):
        misfit = _misfit(value, hint)
        if misfit is not None:
            raise _wrong(name, misfit, owner) from cause


def annotations_of(function: Callable[..., Any]) -> dict[str, Any]:
    """The annotation of every argument of a function, or of every field of a dataclass."""
    module = inspect.unwrap(function).__module__
    return {
        name: _evaluated(item.annotation, module)
        for name, item in inspect.signature(function).parameters.items()
    }


def unfit(value: object, hint: Any) -> str:
    """What a value that its annotation does not allow must be, in words; "" where it fits."""
    misfit = _misfit(value, hint)
    return "" if misfit is None else _words(misfit[2])


def _annotated(
    function: Callable[..., Any], args: tuple[Any, ...], keywords: Mapping[str, Any]
) -> Iterator[tuple[str, object, Any]]:
    """Name, value and annotation of every argument, or of every field where the function is
    __post_init__.
    """
    if function.__name__ == "__post_init__":
        for owner in type(args[0]).__mro__:
            for name, annotation in vars(owner).get("__annotations__", {}).items():
                yield name, getattr(args[0], name), _evaluated(annotation, owner.__module__)
        return
    try:
        bound = inspect.signature(function).bind(*args, **keywords)
    except TypeError:  # Python's own message says which argument is missing or unknown
        return
    for name, value in bound.arguments.items():
        parameter = bound.signature.parameters[name]
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            yield name, value, _evaluated(parameter.annotation, inspect.unwrap(function).__module__)


class _Names(dict[str, Any]):
    """Names of a module, and those that it imports for type checkers alone, from whichever module
    of the package has them.
    """

    def __missing__(self, name: str) -> Any:
        package = __name__.partition(".")[0]
        for module in [module for key, module in sys.modules.items() if key.startswith(package)]:
            if name in vars(module):
                return vars(module)[name]
        raise KeyError(name)


def _evaluated(annotation: Any, module: str) -> Any:
    """The annotation as an object; Any where it cannot be told."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return _evaluated_once(annotation, module)
    except (NameError, TypeError, AttributeError):
        return Any


@cache
def _evaluated_once(annotation: str, module: str) -> Any:
    return eval(annotation, {}, _Names(vars(sys.modules[module])))


def _misfit(value: object, hint: Any) -> Misfit | None:
    """What of ``value`` the annotation does not allow; None where it fits, or where the annotation
    says too little to tell.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any or hint is inspect.Parameter.empty:
        return None
    if origin is Annotated:
        return _misfit(value, inner[0])
    if origin in (Union, UnionType):
        misfits = [_misfit(value, part) for part in inner]
        if any(misfit is None for misfit in misfits):
            return None
        # the one that came furthest
        return next((misfit for misfit in misfits if misfit and misfit[0]), ("", value, hint))
    if origin is Literal:
        fits = any(type(value) is type(allowed) and value == allowed for allowed in inner)
    elif hint in _NUMBERS:
        scalar = (
            isinstance(value, np.ndarray | np.generic)
            and value.ndim == 0
            and value.dtype.kind in _NUMBERS[hint]
        )
        plain = {float: int | float, complex: int | float | complex}.get(hint, hint)
        fits = scalar or (
            isinstance(value, plain)
            and not (isinstance(value, int) and abs(value) > sys.float_info.max)
        )
    elif inspect.isclass(origin) and issubclass(origin, Iterable):
        alike = (tuple, list) if origin is tuple else origin
        return (
            _misfit_within(value, origin, inner) if isinstance(value, alike) else ("", value, hint)
        )
    elif inspect.isclass(origin or hint) and not getattr(hint, "_is_protocol", False):
        fits = isinstance(value, origin or hint)
    else:
        return None
    return None if fits else ("", value, hint)


def _misfit_within(value: Any, origin: type, inner: tuple[Any, ...]) -> Misfit | None:
    """The first element that the annotation of a sequence or mapping does not allow."""
    if issubclass(origin, Mapping):
        elements, hints = value.items(), inner[1:]
    elif origin is tuple and inner[-1:] != (...,):
        if len(value) != len(inner):
            return "", value, tuple[inner]  # type: ignore[valid-type]
        elements, hints = enumerate(value), inner
    else:
        elements, hints = enumerate(value), inner[:1]
    for i, (key, element) in enumerate(elements):
        misfit = _misfit(element, hints[i] if len(hints) > 1 else hints[0]) if hints else None
        if misfit is not None:
            return f"[{key!r}]{misfit[0]}", misfit[1], misfit[2]
    return None


def _shown(value: object) -> str:
    if isinstance(value, str | bytes | float | bool | NoneType):
        return repr(value) if len(repr(value)) <= 60 else f"{repr(value)[:50]} ..."
    if isinstance(value, int):
        return (
            repr(value) if abs(value) < sys.float_info.max else "an integer of hundreds of digits"
        )
    return (
        f"the class {value.__name__}"
        if isinstance(value, type)
        else f"of type {type(value).__name__}"
    )


def _words(hint: Any) -> str:
    """The annotation in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _words(inner[0])
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_words(part) for part in inner))
    if origin is Literal:
        return " or ".join(map(repr, inner))
    kind = origin or hint
    if kind in _WORDS or kind is Callable:
        return _WORDS.get(kind, "a function")
    if not inspect.isclass(kind):
        return "something else"
    if issubclass(kind, Mapping):
        return "a dictionary"
    if inner and issubclass(kind, Iterable):
        return f"a list with {_words(inner[0])} in each place"
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
