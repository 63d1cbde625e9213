"""Parameters that move: schedules over speed and pressure, proofs along motions, the monitor."""

ANNEX = {
    "site command": {"monitor": "monitor_command:monitor"},
    "public": {"monitor": "monitor", "lpv_synthesis": "lpv.synthesis", "Lpv": "lpv.method"},
    "page": {"SealHistory": "monitor:monitor_page"},
    "method": {"lpv": "lpv.method:Lpv"},
    "moving_proof": {"pressure and speed": "moving_proofs"},
    "companion": {"seal monitor": "seal_watch:watched"},
}
