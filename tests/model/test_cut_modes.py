"""The bound on what the cut modes do, against the free rotor in all modes of its mesh: above the
error, and not far.
"""

import numpy as np
import pytest
import scipy.linalg as sla

import ambrose as amb
from ambrose.model.assemble import compliance_error_bound, in_plane, modes_of, port_positions
from ambrose.model.effects.rotor import finite_element_rotor, plane_rows


def compliance(Phi, frequency, rotor, machine, speed, omega):
    """(w, p, p) [m/N] in the coordinates Phi, of which those with frequencies are damped."""
    rows, G = (
        plane_rows(rotor, port_positions(machine))[0] @ Phi,
        Phi.T @ rotor.plane_gyroscopic @ Phi,
    )
    own = frequency**2, 2j * machine.modal_damping * frequency
    return np.array(
        [
            rows @ np.linalg.solve(np.diag(own[0] - w**2 + w * own[1]) + w * speed * G, rows.T)
            for w in omega
        ]
    )


def every_mode(kept, frequency, rotor):
    """The kept modes and those of their complement, so that both models round alike in what they
    share.
    """
    M, K = rotor.plane_mass, rotor.plane_stiffness
    rest = sla.null_space(kept.T @ M)
    squares, mix = sla.eigh(rest.T @ K @ rest, rest.T @ M @ rest)
    return np.hstack([kept, rest @ mix]), np.concatenate([frequency, np.sqrt(squares)])


@pytest.mark.parametrize("name", ["seal-rig", "turboexpander", "process-compressor"])
@pytest.mark.parametrize("turns", [0.0, 1.0, 5.0])
def test_bound_holds_and_is_not_far(name, turns):
    machine = amb.load_machine(name)
    rotor, speed = (
        finite_element_rotor(machine),
        turns * (machine.operation.speed_range[1] or 600.0),
    )
    modes = modes_of(machine, rotor, None)
    Phi, frequency = in_plane(modes), modes.frequencies[0::2]
    kept = {"process-compressor": 66}.get(name, 26)
    whole, all_frequencies = every_mode(Phi[:, :kept], frequency[:kept], rotor)
    resonances = all_frequencies[2:10] * (1 + 1e-4)
    omega = np.concatenate([np.geomspace(30.0, 3 * all_frequencies[kept], 60), resonances])
    omega = np.concatenate([omega, -omega])
    ours = compliance(Phi, frequency, rotor, machine, speed, omega)
    exact = compliance(whole, all_frequencies, rotor, machine, speed, omega)
    error, size = (np.linalg.norm(part, 2, axis=(1, 2)) for part in (exact - ours, exact))
    bound = compliance_error_bound(machine, speed, omega)
    rounding = 2e-13 * size
    assert (error <= bound + rounding).all()
    told = (np.abs(omega) < all_frequencies[kept] / 10) & (error > 100 * rounding)
    # at a resonance that the rest could move there is no bound
    half, most, all_ = np.percentile(bound[told] / error[told], [50, 90, 100], method="nearest")
    print(f"{name}, {speed:.0f} rad/s: bound over error {half:.1f}, {most:.1f}, {all_:.1f}")
    assert half < 10 and most < 12


def test_rotors_in_all_their_modes_have_no_error():
    machine = amb.load_machine("flywheel")
    assert (compliance_error_bound(machine, 100.0, np.array([10.0, 1e4])) == 0).all()
