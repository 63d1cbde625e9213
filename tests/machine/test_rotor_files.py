"""Rotor models of ROSS and tables of stations: read, refused in one sentence, written so that ROSS loads them."""


# The compressor of ROSS' own tests (ross/tests/data/compressor_example.toml): length [m], then (inner, outer diameter [m], 1:
# steel, 0: without stiffness) from the inside out; discs: node, mass [kg]. Its free-free bending frequencies [Hz], mass [kg] and
# polar inertia [kg m2] were computed by ross-rotordynamics 2.3.0 from M() and K() of its shaft and discs.
