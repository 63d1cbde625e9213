"""The chain in a browser: a server for one project folder, with a rig that lives in the page."""

ANNEX = {"design command": {"workbench": "command:workbench"}}
