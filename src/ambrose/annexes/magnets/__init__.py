"""What a machine's magnets make of their geometry: coefficients, fluxes, inductance, how straight
the force law is, what a lost coil leaves.
"""

ANNEX = {
    "design command": {"magnet": "command:magnet_command"},
    "public": {"magnet_sheets": "analysis"},
    "page": {"MagnetSheets": "analysis:magnet_page"},
}
