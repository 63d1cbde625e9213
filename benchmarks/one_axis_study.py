"""`identify --generic` on loops of the tests' own: how often the intervals hold the truth, and what
is refused.

    python -m benchmarks.one_axis_study                    every condition, 200 records each
    python -m benchmarks.one_axis_study binary quantised   those alone
    python -m benchmarks.one_axis_study --records 20       fewer records
    python -m benchmarks.one_axis_study --mistakes         records that are not what they seem, 40 each

A record: 4 s at 2 kHz of a plant with the pole 80 rad/s, sensor noise 1 um, force noise that alone
moves it by 14 um rms, a PD that the method is not told.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

import ambrose as amb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from one_axis_loop import Truth, hang, levitate

_PLAIN = Truth()
# condition: truth, whether the reference is recorded, what differs
CONDITIONS = {
    "binary": (_PLAIN, True, {}),
    "binary, no reference": (_PLAIN, False, {}),
    "steps": (_PLAIN, True, {"kind": "steps"}),
    "chirp": (_PLAIN, True, {"kind": "chirp"}),
    "sines, coloured force": (_PLAIN, True, {"kind": "sines", "colour": 0.1}),
    "coloured force, no reference": (_PLAIN, False, {"colour": 0.1}),
    "actuator of 0.5 ms": (replace(_PLAIN, lag=5e-4), True, {}),
    "actuator of 2 ms": (replace(_PLAIN, lag=2e-3, delay=2e-4), True, {"force": 0.01}),
    "quantised to 5 um": (_PLAIN, True, {"step": 5e-6}),
    "sensor noise of 5 um": (_PLAIN, True, {"sensor": 5e-6}),
    "u recorded with 1 % noise": (_PLAIN, True, {"drive_noise": 1e-4}),
    "rate of 1 kHz": (replace(_PLAIN, rate=1000.0, delay=1.3e-3), True, {"n": 4000}),
    "faint binary": (_PLAIN, True, {"size": 0.2}),
    "nothing drives it": (_PLAIN, False, {"kind": "none"}),
    "nothing, u recorded with 1 % noise": (_PLAIN, False, {"kind": "none", "drive_noise": 3e-5}),
}
_NAMES = ("pole", "gain", "delay")


def judge(truth: Truth, referenced: bool, change: dict, records: int) -> dict:
    """Of so many records: refused, doubted, and of those that pass in how many every interval holds
    the truth, the formal one and the reported one.
    """
    _, y, u, r = levitate(truth, runs=records, seed=11, **change)
    counts = {"refused": 0, "not this model": 0, "doubted": 0, "silent": 0}
    inside: dict[str, list] = {"formal": [], "reported": [], "width": [], "halves": []}
    for j in range(records):
        signals = [y[:, j], u[:, j], *([r[:, j]] if referenced else [])]
        names = ("y_x", "u_x", "e_x")[: len(signals)]
        record = amb.Record("rig", truth.rate, names, ("m", "A", "A")[: len(signals)], signals)
        try:
            done = amb.identify_generic(record)
        except amb.InvalidInput:
            counts["refused"] += 1
            continue
        if done.verdict != "identified":
            counts["not this model"] += 1
            continue
        counts["doubted"] += not done.passed
        errors, formal, reported = errors_of(done, truth)
        inside["formal"].append(errors <= formal)
        inside["reported"].append(errors <= reported)
        inside["width"].append(reported / np.array([truth.pole, truth.gain, truth.delay]))
        inside["halves"].append([done.value(name).source == "halves" for name in _NAMES])
        counts["silent"] += done.passed and bool((errors > 1.53 * reported).any())
    return {**counts, **{key: np.array(rows) for key, rows in inside.items()}}


def errors_of(done, truth: Truth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|found - true|, formal and reported half-widths of pole, gain and delay; the delay with the
    actuator's lag, by both where one was found.
    """
    values = [done.value(name) for name in _NAMES]
    found = np.array([item.value for item in values])
    formal = np.array([item.formal for item in values])
    reported = np.array([item.half_width for item in values])
    if done.estimate.structure.lag:
        found[2] += done.value("lag").value
        spread = done.estimate.covariance[2:4, 2:4].sum()
        reported[2] = formal[2] = 1.96 * np.sqrt(max(spread, 0.0))
    true = np.array([truth.pole, truth.gain, truth.delay + truth.lag])
    return np.abs(found - true), formal, reported


def _plain(seed: int, **change) -> tuple[Truth, np.ndarray, np.ndarray, np.ndarray]:
    truth = change.pop("truth", _PLAIN)
    _, y, u, r = levitate(truth, seed=seed, **change)
    return truth, y[:, 0], u[:, 0], r[:, 0]


def _changed(seed: int, how) -> tuple[Truth, np.ndarray, np.ndarray, np.ndarray]:
    truth, y, u, r = _plain(seed)
    return truth, *how(np.random.default_rng(seed), y, u, r)


def _two_points(seed: int) -> tuple[Truth, np.ndarray, np.ndarray, np.ndarray]:
    """Warm after half of the record: the pole from 80 to 96 rad/s."""
    first = _plain(seed, n=4000)[1:]
    second = _plain(seed + 1000, n=4000, truth=replace(_PLAIN, pole=96.0))[1:]
    return _PLAIN, *(np.concatenate(pair) for pair in zip(first, second, strict=True))


def _hanging(seed: int, amplitude: float) -> tuple[Truth, np.ndarray, np.ndarray, np.ndarray]:
    _, y, i, aim = hang(seed=seed, amplitude=amplitude)
    # the tangent of c/m (i/y)^2, c/m = 0.005, at the mean of both
    gain = 2 * 0.005 * float(i.mean()) / float(y.mean()) ** 2
    truth = Truth(float(np.sqrt(gain * i.mean() / y.mean())), -gain, 0.0)
    return truth, y, i, aim


def _with_tone(rng, y, u, r):
    time = np.arange(len(y)) / 2000
    return y + 2e-5 * np.sin(314 * time + rng.uniform(0, 6.3)), u, r


MISTAKES = {
    "a bending mode at five times the pole": lambda s: _plain(s, mode=400.0),
    "a bending mode at twelve times the pole": lambda s: _plain(s, mode=960.0),
    "the pole 20 % higher in the second half": _two_points,
    "a magnet moved by 0.6 % of its gap": lambda s: _hanging(s, 3e-5),
    "a magnet moved by 6 % of its gap": lambda s: _hanging(s, 3e-4),
    "anti-alias filter of 100 Hz before the logger": lambda s: _changed(
        s, lambda g, y, u, r: (lfilter([0.27], [1, -0.73], y), u, r)
    ),
    "u of another axis": lambda s: (*_plain(s)[:2], *_plain(s + 500)[2:]),
    "another loop's reference": lambda s: (*_plain(s)[:3], _plain(s + 500)[3]),
    "the control error as reference": lambda s: _changed(s, lambda g, y, u, r: (y, u, r / 300 - y)),
    "the control error as reference, nothing drives it": lambda s: (
        *(quiet := _plain(s, kind="none"))[:3],
        -quiet[1],
    ),
    "y logged at half the rate, each value twice": lambda s: _changed(
        s, lambda g, y, u, r: (np.repeat(y[::2], 2), u, r)
    ),
    "y in steps of half its deviation": lambda s: _changed(
        s, lambda g, y, u, r: (np.round(y / y.std() * 2) / 2 * y.std(), u, r)
    ),
    "u in steps of half its deviation": lambda s: _changed(
        s, lambda g, y, u, r: (y, np.round(u / u.std() * 2) / 2 * u.std(), r)
    ),
    "y clipped at one and a half deviations": lambda s: _changed(
        s, lambda g, y, u, r: (np.clip(y, -1.5 * y.std(), 1.5 * y.std()), u, r)
    ),
    "hum of 50 Hz on the sensor's line": lambda s: _changed(s, _with_tone),
    "50 samples of u lost in the middle": lambda s: _changed(
        s, lambda g, y, u, r: (y[:-50], np.delete(u, slice(4000, 4050)), r[:-50])
    ),
}


def try_mistake(make, records: int) -> list[int]:
    """Refused, not this model, doubted, passed and right, passed and wrong (beyond 3 deviations of
    pole or gain).
    """
    counts = [0] * 5
    for seed in range(records):
        truth, *signals = make(seed)
        record = amb.Record(
            "rig", truth.rate, ("y_x", "u_x", "e_x"), ("m", "A", "A"), np.array(signals)
        )
        try:
            done = amb.identify_generic(record)
        except amb.InvalidInput:
            counts[0] += 1
            continue
        errors, _, reported = errors_of(done, truth)
        wrong = bool((errors > 1.53 * reported)[:2].any())
        if done.verdict != "identified":
            counts[1] += 1
        elif not done.passed:
            counts[2] += 1
        else:
            counts[4 if wrong else 3] += 1
    return counts


def main(words: list[str]) -> None:
    if "--mistakes" in words:
        records = int(words[words.index("--records") + 1]) if "--records" in words else 40
        print("| mistake | refused | not this model | doubted | passed, right | silent wrong |")
        print("|---|---|---|---|---|---|")
        for name, make in MISTAKES.items():
            print(f"| {name} | {' | '.join(map(str, try_mistake(make, records)))} |", flush=True)
        return
    records = int(words[words.index("--records") + 1]) if "--records" in words else 200
    asked = [name for name in CONDITIONS if name in words] or list(CONDITIONS)
    print(
        "| condition | refused | not this model | doubted | formal holds p, b, tau | "
        "reported holds | from halves | half-width p, b, tau | silent |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in asked:
        began = time.process_time()
        told = judge(*CONDITIONS[name], records)
        cells = [str(told[key]) for key in ("refused", "not this model", "doubted")]
        if len(told["formal"]):
            for key in ("formal", "reported", "halves"):
                cells.append(", ".join(f"{100 * v:.1f}" for v in told[key].mean(axis=0)) + " %")
            width = np.median(told["width"], axis=0)
            cells.append(", ".join(f"{100 * v:.2g}" for v in width) + " %")
        else:
            cells += ["-"] * 4
        seconds = (time.process_time() - began) / records
        print(f"| {name} | {' | '.join(cells)} | {told['silent']} |  {seconds:.2f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
