"""Wrong types named from annotations: only where a call fails, only what cannot be meant, and
defects stay defects.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, names_wrong_types

Shade = Literal["dark", "light"]


@names_wrong_types
def paint(
    count: int,
    size: float | None = None,
    shade: Shade = "dark",
    path: str | os.PathLike[str] = "",
    names: Sequence[str] = (),
    pairs: tuple[tuple[str, float], ...] = (),
    values: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
    anything: Any = None,
    unknown: NoSuchName = None,  # noqa: F821
) -> int:
    """Fails in every call; what of its arguments is to blame is for the decorator to say."""
    raise TypeError("inside")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"count": "x"}, "count is 'x', but must be a whole number"),
        ({"count": 1.5}, "count is 1.5, but must be a whole number"),
        ({"count": None}, "count is None"),
        ({"size": "2"}, "size is '2', but must be a number or None"),
        ({"size": 10**400}, "size is an integer of hundreds of digits"),
        ({"size": np.zeros(3)}, "size is of type ndarray"),
        ({"size": 1j}, "size is of type complex"),
        ({"shade": "grey"}, "shade is 'grey', but must be 'dark' or 'light'"),
        ({"shade": []}, "shade is of type list"),
        ({"path": 3}, "path is 3, but must be a text or a path"),
        ({"names": [1]}, r"names\[0\] is 1, but must be a text"),
        ({"names": 4}, "names is 4, but must be a list with a text in each place"),
        ({"pairs": [("a", 1.0), ("b", "c")]}, r"pairs\[1\]\[1\] is 'c', but must be a number"),
        ({"pairs": [("a",)]}, r"pairs\[0\] is of type tuple"),
        ({"values": {"a": None}}, r"values\['a'\] is None, but must be a number"),
        ({"progress": "x"}, "progress is 'x', but must be a function or None"),
        ({"shade": "y" * 500}, r"'y+ \.\.\., but"),
        ({"names": int}, "names is the class int"),
    ],
)
def test_the_first_argument_that_cannot_be_meant_is_named(arguments, words):
    with pytest.raises(InvalidInput, match=words) as refusal:
        paint(**{"count": 1} | arguments)
    assert str(refusal.value).endswith("see help(paint)")
    assert isinstance(refusal.value.__cause__, TypeError)


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"size": np.float64(2)},
        {"size": np.array(2)},
        {"names": "bare"},
        {"names": ["a"], "pairs": [["a", 1]]},
        {"anything": object(), "unknown": object()},
        {"count": np.int64(3), "progress": print, "path": os.curdir},
    ],
)
def test_a_defect_stays_where_every_argument_fits(arguments):
    with pytest.raises(TypeError, match="inside"):
        paint(**{"count": 1} | arguments)


def test_an_unknown_keyword_is_answered_by_python():
    with pytest.raises(TypeError, match="colour"):
        paint(1, colour="red")


@dataclass(frozen=True)
class Part:
    name: Annotated[str, "its name"]
    sizes: tuple[float, ...] = ()

    @names_wrong_types
    def __post_init__(self) -> None:
        sum(self.sizes)
        self.name.strip()


class Unannotated:
    @names_wrong_types
    def __init__(self, given, size: float) -> None:
        self.size = size + 1


def test_what_has_no_annotation_is_never_to_blame():
    with pytest.raises(
        InvalidInput, match=r"size is 'x', but must be a number; see help\(Unannotated\)"
    ):
        Unannotated(None, "x")


def test_fields_of_a_dataclass():
    Part("a", (1.0, 2.0))
    with pytest.raises(InvalidInput, match=r"name is 3, but must be a text; see help\(Part\)"):
        Part(3)
    with pytest.raises(InvalidInput, match=r"sizes\[1\] is 'b', but must be a number"):
        Part("a", (1.0, "b"))


def test_front_door_functions_can_be_sent_to_other_processes():
    import ambrose as amb

    for function in (amb.design, amb.mu_bounds, amb.time_response):
        assert pickle.loads(pickle.dumps(function)) is function
