"""Landing: the rotor without its magnets in its touchdown bearings, whirl before any simulation,
drops, and many of them.
"""

ANNEX = {
    "design command": {"landing": "command:landing_command"},
    "public": {"landing": "analysis"},
    "page": {"Landing": "page:landing_page"},
}
