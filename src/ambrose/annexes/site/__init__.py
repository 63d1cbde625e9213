"""Beside the machine: frequency responses, acceptance, balancing, calibration, bias, retuning."""

ANNEX = {
    "site command": {
        "accept": "commands:accept",
        "balance": "commands:balance",
        "bias": "commands:bias",
        "calibrate": "commands:calibrate",
        "frf": "commands:frf",
        "retune": "commands:retune",
    },
    "public": {
        "accept": "acceptance",
        "Acceptance": "acceptance",
        "balance": "balancing",
        "balance_vectors": "balancing_vectors",
        "coefficients_of_trials": "balancing_vectors",
        "calibrate": "calibration",
        "retune": "retuning",
        "Retuning": "retuning",
    },
    "page": {
        "Acceptance": "pages:acceptance_page",
        "BiasCampaign": "pages:bias_page",
        "Responses": "pages:frf_page",
        "Retuning": "pages:retuning_page",
    },
}
