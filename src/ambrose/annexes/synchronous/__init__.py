"""Synchronous blocks: filters at the speed of rotation beside a controller, against unbalance."""

ANNEX = {
    "beside": {
        "request": "block_design:check_request",
        "design": "block_design:design_synchronous",
        "refuse": "block_loop:check_blocks",
        "loops": "block_checks:block_loops",
        "check": "block_checks:check_block",
        "doubts": "block_checks:block_doubts",
        "program": "running:beside_law",
        "unit": "block_code:unit_beside",
    },
}
