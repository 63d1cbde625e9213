"""The physics, one file per effect.

ROOM registers the effects that act where they stand and have a table of the machine file: its name
-> "file:object", a ``model.effect.Effect``. Each of them is its file and its line here, nothing
else.
"""

ROOM = {
    "effect": {
        "coupling": "stations:COUPLING",
        "journal_bearing": "stations:JOURNAL_BEARING",
        "stage": "stations:STAGE",
        "clearance": "stations:CLEARANCE",
        "probe": "stations:PROBE",
        "load": "stations:LOAD",
        "thrust_bearing": "stations:THRUST_BEARING",
    },
}
