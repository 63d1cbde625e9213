"""The physics, one file per effect.

ROOM registers the effects that act where they stand and have a table of the machine file: its name
-> "file:object", a ``model.effect.Effect``. Each of them is its file and its line here, nothing
else.
"""

ROOM = {
    "effect": {
        "coupling": "coupling:COUPLING",
        "journal_bearing": "journal_bearing:JOURNAL_BEARING",
        "stage": "stage:STAGE",
        "clearance": "clearance:CLEARANCE",
        "probe": "probe:PROBE",
        "load": "load:LOAD",
        "thrust_bearing": "thrust_bearing:THRUST_BEARING",
    },
}
