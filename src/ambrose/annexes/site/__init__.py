"""Beside the machine: frequency responses, acceptance, balancing, calibration, bias currents."""

ANNEX = {
    "site command": {
        "accept": "accept_command:accept",
        "balance": "balance_command:balance",
        "bias": "bias_command:bias",
        "calibrate": "calibrate_command:calibrate",
        "frf": "frf_command:frf",
    },
    "public": {
        "accept": "acceptance",
        "Acceptance": "acceptance",
        "balance": "balancing.correction",
        "calibrate": "calibration",
    },
    "page": {
        "Acceptance": "acceptance_page:acceptance_page",
        "BiasCampaign": "bias_page:bias_page",
        "Responses": "frf_page:frf_page",
    },
}
