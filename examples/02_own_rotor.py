"""A machine file of your own: mass, bending frequencies, and bearings that lie between nodes."""

from pathlib import Path

import numpy as np

import ambrose as amb

machine = amb.load_machine(Path(__file__).with_name("bench_rotor.toml"))
rotor = amb.finite_element_rotor(machine)
mass = amb.mass_properties(rotor).mass
bending_hz = amb.free_bending_frequencies(rotor, 2) / (2 * np.pi)
result = amb.design(machine, "pid")


def picture():
    return amb.plot(machine)


if __name__ == "__main__":
    print(f"{mass:.1f} kg, free bending at {bending_hz[0]:.0f} and {bending_hz[1]:.0f} Hz")
    print(
        f"PID: {result.status}, largest sensitivity "
        f"{result.certificate.margins.get('sensitivity_peak', np.inf):.2f}"
    )
