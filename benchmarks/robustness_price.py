"""What robustness costs on the seal rig (k alone uncertain, P5 section 4.1): the least control
gain, amplifier bandwidth and bias current that still meet every requirement, over the width of k
about its nominal pressure.

    python -m benchmarks.robustness_price [--widths 50,80,100,110,120,150] [--lever gain]      minutes for each lever
"""

import argparse
import time
from dataclasses import replace

import ambrose as amb
from ambrose.synthesis.methods import Tuned


def machine():
    """The rig at its nominal pressure: the other points are ends of the range of k, which is what
    is varied here.
    """
    rig = amb.load_machine("seal-rig-k-only")
    nominal = rig.operation.nominal
    operation = replace(
        rig.operation,
        points=(nominal,),
        speed_range=(0.0, nominal.speed),
        design_point=None,
        ranges=(),
    )
    return replace(rig, operation=operation)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--widths", default="50,80,90,100,110,120,150,200", help="per cent of k")
    parser.add_argument("--lever", action="append", choices=("gain", "bandwidth", "bias"))
    given = parser.parse_args()
    widths = [float(word) / 100 for word in given.widths.split(",")]
    for lever in given.lever or ("gain", "bandwidth"):
        start = time.process_time()
        reserve = 0.0 if lever == "bias" else 2.0
        found = amb.price(
            machine(), "seal.center.k", widths, lever, Tuned(rate=10_000), reserve=reserve
        )
        for width, item in zip(found.widths, found.found, strict=True):
            told = f"{item.value:.4g}" if item.value < float("inf") else "none"
            print(
                f"{lever:10} k +-{100 * width:3.0f} %: least {told:>10}, failed below "
                f"{item.refused:.3g}, binds: {item.binding}"
            )
        print(f"{lever}: {time.process_time() - start:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    main()
