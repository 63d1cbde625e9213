"""Parameters that move: schedules over speed and pressure, proofs along motions, the monitor."""

ANNEX = {
    "site command": {"monitor": "monitor_command:monitor"},
    "public": {"monitor": "front_door", "lpv_synthesis": "lpv.synthesis", "Lpv": "lpv.method"},
    "page": {"SealHistory": "monitor_page:monitor_page"},
    "method": {"lpv": "lpv.method:Lpv"},
    "moving_proof": {"pressure and speed": "moving.proofs"},
    "companion": {"seal monitor": "watched:watched"},
}
