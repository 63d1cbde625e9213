"""`identify --generic` on loops of the tests' own: how often the intervals hold the truth, and what
is refused.

    python -m benchmarks.one_axis_study                    every condition, 200 records each
    python -m benchmarks.one_axis_study binary quantised   those alone
    python -m benchmarks.one_axis_study --records 20       fewer records

A record: 4 s at 2 kHz of a plant with the pole 80 rad/s, sensor noise 1 um, force noise that alone
moves it by 14 um rms, a PD that the method is not told.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import ambrose as amb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from one_axis_loop import Truth, levitate

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
        counts["silent"] += done.passed and bool((errors > 2.53 * reported).any())
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


def main(words: list[str]) -> None:
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
