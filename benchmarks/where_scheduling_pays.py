"""Where scheduling over the seal's strength could pay: one fixed controller for a range of k
against the best one at every k.

    python -m benchmarks.where_scheduling_pays [--machine seal-rig-k-only] [--rate-hz 10000]      two minutes
    python -m benchmarks.where_scheduling_pays --machine turboexpander --rate-hz 20000 --speeds-hz 20 140 300

No scheduled controller of the same order does better at a frozen k than the one that is tuned for
that k alone. What a fixed one loses against the worst of these over its range is therefore the most
that scheduling could win; that tuning found the best is assumed. With speeds: k alone is moved, at
each of the speeds and over all of them at once, and the schedule is designed: over k, or over speed
and k.
"""

import argparse
import math
import time
from dataclasses import replace
from itertools import product

import numpy as np

import ambrose as amb
from ambrose.annexes.scheduled.lpv.synthesis import lpv_synthesis
from ambrose.annexes.sizing.least import tuning_job
from ambrose.core.checks import NumericalFailure
from ambrose.judge.result import certify
from ambrose.law.design_problem import (
    apply_delay,
    design_plant,
    machine_weights,
    open_model,
    scale_control,
)
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.synthesis.fixed_order.job import first_law, prepare
from ambrose.synthesis.fixed_order.tuning import tuned
from ambrose.synthesis.methods import Tuned

RANGE = (0.0, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
# of S_o; factor of the machine's control weight for the schedule, which lowers S_o
LIMIT, CONTROL = 3.0, 0.5
HEADS = (
    "k up to, times nominal",
    "fixed, worst of its range",
    "tuned for that k alone",
    "worst of these",
    "most to win",
)


def at(machine, shares):
    """The machine at these shares of its nominal pressure and nowhere else, without tolerances."""
    nominal, words = machine.operation.nominal, "times nominal pressure"
    points = tuple(
        replace(nominal, seal_pressure=share * nominal.seal_pressure, label=f"{share:g} {words}")
        for share in shares
    )
    operation = replace(
        machine.operation,
        points=points,
        design_point="",
        ranges=(),
        speed_range=(0.0, nominal.speed),
    )
    return replace(machine, operation=operation, tolerances=())


def sensitivity(machine, options, near=None):
    """The worst sigma_max(S_o) over the machine's points that tuning reaches (inf: none was found),
    as the loop runs, on full plants, and the controller. near: one to begin with besides the
    machine file's PID.
    """
    best = float("inf"), None
    for start in {near, None}:
        try:
            job, law = tuning_job(machine, options, 60.0)
            law = tuned(
                job, law if start is None else start, "free", again=start is not None
            ).controller
        except NumericalFailure:
            continue
        found = amb.verify(machine, law, rate=options.rate, delay_samples=1, tolerances=False)
        peaks = [
            next(c.value for c in point.checks if c.name == "sensitivity.output.max")
            for point in found.points
        ]
        peak = max(peaks) if all(point.stable for point in found.points) else float("inf")
        best = min(best, (peak, law), key=lambda item: item[0])
    return best


class Map:
    """The machine with its cross-coupled stiffness at ``share`` times nominal and all else as it
    is, at a speed.
    """

    def __init__(self, machine, options):
        self.machine, self.options = replace(machine, tolerances=()), options
        self.k = [
            Tolerance(f"seal.{seal.name}.{entry}", relative=1.0)
            for seal in machine.seals
            for entry in ("k_xy", "k_yx")
        ]
        self.kept, self.timing = {}, options.timing()

    def plant(self, speed, share):
        if (speed, share) not in self.kept:
            plant = assemble(self.machine, replace(self.machine.operation.design, speed=speed))
            self.kept[speed, share] = perturbed(
                plant, {item.parameter: share - 1 for item in self.k}, self.k
            )
        return self.kept[speed, share]

    def worst(self, law_at, speeds, top):
        """The largest sigma_max(S_o) as it runs on full plants, at each of the speeds and at five k
        up to ``top``.
        """
        points = product(speeds, np.linspace(0, top, 5).tolist())
        found = [
            certify(self.plant(*p), self.timing.in_loop(law_at(*p)), margins=False) for p in points
        ]
        return max(item.closed_loop_norm for item in found)

    def fixed(self, speeds, top, near):
        plants = [self.plant(*p) for p in product(speeds, (0.0, top / 2, top))]
        start, options = pid_controller(self.machine.reference, self.machine), self.options
        best = math.inf, near
        for start_from in {near, None}:
            try:
                job = prepare(
                    plants, start, self.timing, options.order, "free", None, None, 60.0, None
                )
                job.most_states = None
                first = (
                    first_law(job, start, options.order, "free")
                    if start_from is None
                    else start_from
                )
                law = tuned(job, first, "free", again=start_from is not None).controller
            except NumericalFailure:
                continue
            worst = self.worst(lambda *_, law=law: law, speeds, top)
            best = min(best, (worst, law), key=lambda item: item[0])
        return best

    def scheduled(self, speeds, top):
        """Over k, and over the speed where there are several."""
        several, weights = len(speeds) > 1, scale_control(machine_weights(self.machine), CONTROL)
        names = ("speed and k", "rad/s and times nominal") if several else ("k", "times nominal")

        def at(value):
            speed, share = value if several else (speeds[0], value)
            plant, offsets = self.plant(speeds[0], 1.0), tuple((item, share - 1) for item in self.k)
            small = free_mode_reduction(
                replace(plant, point=replace(plant.point, speed=speed), offsets=offsets), 0
            )
            return design_plant(
                apply_delay(open_model(small, None, False), self.timing.lag),
                weights,
                uncertain=False,
            )

        shares = np.linspace(0.0, top, 3)
        grid = (np.linspace(speeds[0], speeds[-1], 3), shares) if several else shares
        try:
            law = lpv_synthesis(
                at, grid, backoff=1.1, points_between=1, parameter=names[0], unit=names[1]
            ).scheduled
        except NumericalFailure:
            return math.inf
        return self.worst(
            lambda speed, share: law.at((speed, share) if several else share), speeds, top
        )


def over_speed(machine, options, speeds, tops):
    print(
        "| speed | k from 0 up to, times nominal | fixed, worst S_o | scheduled, worst S_o "
        "|\n|---|---|---|---|"
    )
    job = Map(machine, options)
    for chosen in [list(speeds), *([speed] for speed in speeds)]:
        near, held = None, [True, True]
        for top in tops:
            fixed, scheduled = math.nan, math.nan
            if held[0]:
                fixed, near = job.fixed(chosen, top, near)
            if held[1]:
                scheduled = job.scheduled(chosen, top)
            held = [fixed <= LIMIT, scheduled <= LIMIT]
            where = ", ".join(f"{speed / 2 / math.pi:g}" for speed in chosen)
            print(f"| {where} Hz | {top:g} | {fixed:.2f} | {scheduled:.2f} |", flush=True)
            if not any(held):
                break


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machine", default="seal-rig-k-only")
    parser.add_argument("--rate-hz", type=float, default=10_000)
    parser.add_argument("--order", type=int, default=12)
    parser.add_argument("--speeds-hz", type=float, nargs="+")
    parser.add_argument(
        "--times",
        type=float,
        nargs="+",
        default=[6.0, 12.0, 18.0, 24.0],
        help="upper ends of k, times nominal",
    )
    given = parser.parse_args()
    machine, start = amb.load_machine(given.machine), time.process_time()
    options = Tuned(rate=given.rate_hz, order=given.order).on(machine)
    if given.speeds_hz:
        over_speed(
            machine, options, [2 * math.pi * speed for speed in given.speeds_hz], given.times
        )
        print(f"{time.process_time() - start:.0f} s of processor time")
        return
    worst = 0.0
    alone = (0.0, None)
    fixed = (0.0, None)
    print(f"| {' | '.join(HEADS)} |\n|---|---|---|---|---|")
    for i, share in enumerate(RANGE):
        alone = sensitivity(at(machine, (share,)), options, alone[1])
        worst = max(worst, alone[0])
        fixed = sensitivity(at(machine, RANGE[: i + 1]), options, fixed[1]) if i else alone
        win = 100 * (1 - worst / fixed[0])
        print(
            f"| {share:g} | {fixed[0]:.3f} | {alone[0]:.3f} | {worst:.3f} | {win:.0f} % |",
            flush=True,
        )
    print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
