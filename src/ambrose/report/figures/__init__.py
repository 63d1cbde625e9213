"""Pictures by what they show: curves, Bode plots, motion, seals, the rotor."""
