"""While testing, docstrings are believed and checked: ``omega (w,) [rad/s]`` is a promise about the
argument's shape.

``install()`` (called by conftest before any test imports the package) hooks the import of the
packages below. Each public function whose docstring states shapes is wrapped: after a call that
succeeded, the arrays it was given are compared with the stated shapes (``y (p, k) or (k,)`` allows
both); letters must agree within one call, and a letter that is itself an integer argument
(``count``) has its value. Calls that raise are left alone, for refusing a shape is the function's
right.
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.machinery
import inspect
import re
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

FIRST, EVERY = 5, 100  # calls of a function in one test
PACKAGES = ("ambrose.core", "ambrose.model.effects", "ambrose.model")
_calls: dict[str, int] = {}  # of each function, since the test began
_STATED = re.compile(r"\b([A-Za-z_]\w*) (\([^()]*\)(?: or \([^()]*\))*)")
# not a word of prose
_PART = re.compile(r"\.\.\.|\d+|[a-z]\w?|[a-z]_\w+|[\da-z ]+ [+*-] [\da-z ]{1,3}")


def stated_shapes(function: Callable[..., Any]) -> dict[str, list[str]]:
    """Parameter name -> allowed shapes, for every ``name (shape)`` in the docstring whose name is a
    parameter.
    """
    parameters = inspect.signature(function).parameters
    shapes: dict[str, list[str]] = {}
    for name, text in _STATED.findall(" ".join((function.__doc__ or "").split())):
        choices = [
            [part.strip() for part in shape.split(",") if part.strip()]
            for shape in re.findall(r"\((.*?)\)", text)
        ]
        if name in parameters and all(
            _PART.fullmatch(part) or part in parameters for parts in choices for part in parts
        ):
            shapes.setdefault(name, [f"({', '.join(parts)})" for parts in choices])
    return shapes


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function``, or a wrapper that raises AssertionError when a docstring's shape proves to be a
    lie.
    """
    from ambrose.core.checks import match_shape

    shapes = stated_shapes(function)
    if not shapes:
        return function
    signature = inspect.signature(function)
    name_of_function = f"{function.__module__}.{function.__qualname__}"

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        result = function(*args, **kwargs)
        calls = _calls[name_of_function] = _calls.get(name_of_function, 0) + 1
        if calls > FIRST and calls % EVERY:
            return result
        arguments = signature.bind(*args, **kwargs).arguments
        sizes = {
            name: int(value)
            for name, value in arguments.items()
            if isinstance(value, int | np.integer)
        }
        for name, choices in shapes.items():
            if arguments.get(name) is None:
                continue
            try:
                actual = np.shape(arguments[name])
            except ValueError:  # ragged: not an array
                continue
            fitting = [
                trial for shape in choices if match_shape(actual, shape, trial := dict(sizes))
            ]
            if not fitting:
                given = f"{name_of_function} took {name} with shape {actual}"
                raise AssertionError(
                    f"{given}, but its docstring says {' or '.join(choices)} (known: {sizes})"
                )
            sizes = fitting[0]
        return result

    return wrapper


def wrap_module(module: ModuleType) -> None:
    """Put the check around the public functions that are defined in ``module``."""
    for name, thing in list(vars(module).items()):
        if (
            inspect.isfunction(thing)
            and not name.startswith("_")
            and thing.__module__ == module.__name__
        ):
            setattr(module, name, checked(thing))


def begin() -> None:
    """A test begins: the first calls of every function are looked at again."""
    _calls.clear()


class _Loader(importlib.machinery.SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        wrap_module(module)


class _Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, fullname: str, path: Any, target: ModuleType | None = None) -> Any:
        if (
            not fullname.startswith(tuple(f"{package}." for package in PACKAGES))
            or fullname == "ambrose.core.checks"
        ):
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


def install() -> None:
    """Hook the import system, once; modules that are imported already would escape, so there must
    be none.
    """
    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return
    if early := [
        name
        for name in sys.modules
        if name.startswith(tuple(f"{package}." for package in PACKAGES))
    ]:
        raise RuntimeError(f"{early[0]} was imported before the shape contract; install it first")
    sys.meta_path.insert(0, _Finder())
