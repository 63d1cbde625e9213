"""Hostile calls: whatever a public function is given, it answers, or refuses in one sentence
(InvalidInput and the like).
"""

import inspect
import signal
import threading
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from benchmarks.fuzz_files import hostile, sensible

import ambrose as amb
from ambrose.annexes.scheduled.lpv.method import Lpv
from ambrose.core.checks import InvalidInput
from ambrose.core.worst_case import worst_case_gain

HOSTILE = hostile()
SECONDS = 120  # by the clock, on a busy computer; most calls take a millisecond
ABSTRACT = {"Identification"}


@contextmanager
def limited(call):
    """Ends a call that does not return."""

    def late(number, frame):
        raise TimeoutError(f"{call} does not return")

    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def breaches(name, calls):
    """The calls (keyword arguments) of a public function that end in an error which is none of the
    package's.
    """
    function, found = getattr(amb, name), []
    for call in calls:
        shown = {key: repr(value)[:40] for key, value in call.items()}
        try:
            with warnings.catch_warnings(), limited(f"{name}({shown})"):
                warnings.simplefilter("ignore")
                function(**call)
        except amb.AmbroseError as error:
            assert len(str(error)) > 15, (shown, error)
        except Exception as error:
            found.append(f"{name}({shown}): {type(error).__name__}: {error}")
    return found


def functions():
    for name in sorted(amb.__all__):
        item = getattr(amb, name)
        if (
            callable(item)
            and name not in ABSTRACT
            and not (isinstance(item, type) and issubclass(item, Exception))
        ):
            yield name, inspect.signature(item).parameters.values()


NEEDED = {
    name: [
        p.name
        for p in parameters
        if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]
    for name, parameters in functions()
}


@pytest.mark.parametrize("name", [name for name, needed in NEEDED.items() if needed])
def test_every_argument_hostile(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert breaches(name, [dict.fromkeys(NEEDED[name], value) for value in HOSTILE]) == []


def test_one_argument_hostile(tmp_path, monkeypatch):
    """Each argument of a call that is sensible otherwise, those with defaults, too; a caller's own
    callback may fail.
    """
    monkeypatch.chdir(tmp_path)
    found = []
    for name, call in sensible().items():
        arguments = [
            p
            for p in inspect.signature(getattr(amb, name)).parameters.values()
            if p.kind != p.VAR_KEYWORD
        ]
        known = [p for p in arguments if p.name not in {"progress", "args"}]
        assert set(call) - {"speed"} <= {p.name for p in known}, name
        # half of the values for every argument, the other half for the next one
        calls = [
            {**call, p.name: value} for k, p in enumerate(known) for value in HOSTILE[k % 2 :: 2]
        ]
        complete = [one for one in calls if set(NEEDED[name]) <= set(one)]
        found += breaches(name, complete)
    assert found == []


@pytest.mark.parametrize(
    ("name", "call", "words"),
    [
        ("delayed", {"samples": -3}, "samples is -3"),
        ("delayed", {"samples": 10**6}, "from 0 to 1000"),
        ("delayed", {"samples": 1.5}, "whole number"),
        ("verify", {"tolerances": "no"}, "tolerances is 'no', but must be True or False"),
        ("verify", {"delay_samples": 1.5}, "delay_samples is 1.5, but must be a whole number"),
        (
            "design",
            {"method": "tuned", "order": "few"},
            "order is 'few', but must be a whole number or None",
        ),
        (
            "design",
            {"method": "lpv", "tolerances": "no"},
            "tolerances is 'no', but must be True or False",
        ),
        ("simulate", {"linear": "no"}, "linear is 'no', but must be True or False"),
        ("simulate", {"linear": False, "seed": "x"}, "seed"),
        ("simulate", {"linear": False, "seed": -1}, "seed"),
        ("campaign", {"workers": "two"}, "workers is 'two', but must be a whole number"),
        ("campaign", {"workers": 0}, "1 or more"),
        ("Tolerance", {"relative": -5}, "relative of the tolerance of seal.center.k"),
        ("Tolerance", {"absolute": float("nan")}, "finite"),
        ("C", {"force": "yes"}, "force is 'yes', but must be True or False"),
        ("OperatingPoint", {"speed": 1e300}, "at most 1e.09 rad/s"),
        ("Record", {"sample_rate_hz": 1e300}, "0.0001 to 1e.07 Hz"),
    ],
)
def test_what_was_taken_or_ended_in_a_traceback_is_refused(
    name, call, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(amb.InvalidInput, match=words):
        getattr(amb, name)(**{**sensible()[name], **call})


PARAMETER = amb.RealBlock("a")
PID = amb.StateSpace([], np.zeros((0, 4)), np.zeros((4, 0)), np.eye(4))
TWO = amb.StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        *((lambda v=v: Lpv(speeds=v), "speeds is") for v in (5, object(), (1, "x"), (1, 2, 3), {})),
        *(
            (lambda v=v: worst_case_gain(v, [PARAMETER]), "the system is")
            for v in (1.5, [[1.0]], None, "x")
        ),
        *(
            (lambda v=v: worst_case_gain(TWO, v), "the blocks is")
            for v in (1.5, None, [1.5], "x", [])
        ),
        *(
            (
                lambda name=name, v=v: amb.OperatingPoint(**{name: v}),
                f"{name} of an operating point is",
            )
            for name in ("speed", "seal_pressure", "bias_current", "whirl_frequency")
            for v in (object(), [1.0], 1j, True, "140 Hz")
        ),
        *(
            (lambda v=v: amb.OperatingPoint(label=v), "label of an operating point is")
            for v in (object(), None, 1)
        ),
        (lambda: amb.hinf_norm([None]), "the constant gain[0] is None, but must be finite"),
        (lambda: amb.poles(np.full((2, 2), np.nan)), "the constant gain[0, 0] is nan"),
        *(
            (lambda name=name, v=v: amb.verify("seal-rig", PID, **{name: v}), f"{name} is")
            for name in ("speed_rate", "pressure_rate")
            for v in ("x", -1.0, 0.0, object(), float("nan"))
        ),
    ],
)
def test_what_is_no_number_is_refused_before_anything_is_computed(call, words):
    with pytest.raises(InvalidInput) as refused:
        call()
    assert words in str(refused.value)
    assert str(refused.value).count("\n") == 0
