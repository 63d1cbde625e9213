"""Beside the machine: frequency responses, acceptance, balancing, calibration, bias, retuning."""

ANNEX = {
    "site command": {
        "accept": "accept_command:accept",
        "balance": "balance_command:balance",
        "bias": "bias_command:bias",
        "calibrate": "calibrate_command:calibrate",
        "frf": "frf_command:frf",
        "retune": "retuning.command:retune",
    },
    "public": {
        "accept": "acceptance",
        "Acceptance": "acceptance",
        "balance": "balancing.correction",
        "balance_vectors": "balancing.read_vectors",
        "coefficients_of_trials": "balancing.read_vectors",
        "calibrate": "calibration",
        "retune": "retuning.chain",
        "Retuning": "retuning.result",
    },
    "page": {
        "Acceptance": "acceptance_page:acceptance_page",
        "BiasCampaign": "bias_page:bias_page",
        "Responses": "frf_page:frf_page",
        "Retuning": "retuning.page:retuning_page",
    },
}
