"""Where scheduling over the seal's strength could pay: one fixed controller for a range of k against the best one at every k.

    python -m benchmarks.where_scheduling_pays [--machine seal-rig-k-only] [--rate-hz 10000]      two minutes

No scheduled controller of the same order does better at a frozen k than the one that is tuned for that k alone. What a fixed
one loses against the worst of these over its range is therefore the most that scheduling could win; that tuning found the best
is assumed.
"""

import argparse
import time
from dataclasses import replace

import ambrose as amb
from ambrose.core.checks import NumericalFailure
from ambrose.sizing.guarantee import tuning_job
from ambrose.synthesis.fixed_order.tuning import tuned
from ambrose.synthesis.options import DesignOptions

RANGE = (0.0, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
HEADS = ("k up to, times nominal", "fixed, worst of its range", "tuned for that k alone", "worst of these", "most to win")


def at(machine, shares):
    """The machine at these shares of its nominal pressure and nowhere else, without tolerances."""
    nominal, words = machine.operation.nominal, "times nominal pressure"
    points = tuple(
        replace(nominal, seal_pressure=share * nominal.seal_pressure, label=f"{share:g} {words}") for share in shares
    )
    operation = replace(machine.operation, points=points, design_point="", ranges=(), speed_range=(0.0, nominal.speed))
    return replace(machine, operation=operation, tolerances=())


def sensitivity(machine, options, near=None):
    """The worst sigma_max(S_o) over the machine's points that tuning reaches (inf: none was found), as the loop runs, on full
    plants, and the controller. near: one to begin with besides the machine file's PID."""
    best = float("inf"), None
    for start in {near, None}:
        try:
            job, law = tuning_job(machine, options, 60.0)
            law = tuned(job, law if start is None else start, "free", again=start is not None).controller
        except NumericalFailure:
            continue
        found = amb.verify(machine, law, rate=options.rate, delay_samples=1, tolerances=False)
        peaks = [next(c.value for c in point.checks if c.name == "sensitivity.output.max") for point in found.points]
        peak = max(peaks) if all(point.stable for point in found.points) else float("inf")
        best = min(best, (peak, law), key=lambda item: item[0])
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="seal-rig-k-only")
    parser.add_argument("--rate-hz", type=float, default=10_000)
    parser.add_argument("--order", type=int, default=12)
    given = parser.parse_args()
    machine, start = amb.load_machine(given.machine), time.process_time()
    options = DesignOptions(rate=given.rate_hz, order=given.order).on(machine)
    worst, alone, fixed = 0.0, (0.0, None), (0.0, None)
    print(f"| {' | '.join(HEADS)} |\n|---|---|---|---|---|")
    for i, share in enumerate(RANGE):
        alone = sensitivity(at(machine, (share,)), options, alone[1])
        worst = max(worst, alone[0])
        fixed = sensitivity(at(machine, RANGE[: i + 1]), options, fixed[1]) if i else alone
        win = 100 * (1 - worst / fixed[0])
        print(f"| {share:g} | {fixed[0]:.3f} | {alone[0]:.3f} | {worst:.3f} | {win:.0f} % |", flush=True)
    print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
