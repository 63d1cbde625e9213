"""One controller for all speeds: LPV control of the turboexpander from 20 to 300 Hz, against
H-infinity designed at 140 Hz.
"""

import numpy as np

import ambrose as amb

machine = amb.load_machine("turboexpander")  # its gas seal stiffens tenfold from 20 to 300 Hz
speeds = (2 * np.pi * 20, 2 * np.pi * 300)

# one Lyapunov function: any rate of change is allowed
lpv = amb.design(machine, "lpv", point="140 Hz", speeds=speeds)
fixed = amb.design(machine, "hinf", point="140 Hz")
margins = lpv.certificate.margins

# One second from 20 to 300 Hz, 100 N and 2 um in turn every 50 ms, on the linear loop whose seal
# changes with the speed.
scenario = amb.load_scenario("spin-up-steps")
traces = {
    name: amb.simulate(machine, result, scenario, point="140 Hz", linear=True)
    for name, result in {"LPV": lpv, "H-infinity of 140 Hz": fixed}.items()
}
windows = amb.run_up_steps(traces["LPV"], scenario, [f"y_{axis}" for axis in machine.axes])


def picture():
    return amb.plot(traces["LPV"])


if __name__ == "__main__":
    print(
        f"LPV gamma {lpv.gamma:.3f}, best possible at any single speed "
        f"{margins['pointwise_largest']:.3f}"
    )
    print(
        f"{lpv.status} on the full plant: worst sensitivity {margins['full_sensitivity_peak']:.2f}"
    )
    print("\n".join(lpv.notes))
    print(
        f"LPV: settles in {1e3 * windows[0].settling:.1f} ms at 20 Hz, "
        f"{1e3 * windows[-1].settling:.1f} ms at 300 Hz"
    )
    for name, trace in traces.items():
        print(f"{name}: {trace.text}")
