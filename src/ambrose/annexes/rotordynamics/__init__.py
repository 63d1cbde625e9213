"""The lateral analysis that a machine is bought on: unbalance response, clearances, stability and
capacity, clause by clause.
"""

ANNEX = {
    "design command": {
        "lateral": "command:lateral_command",
        "compare": "command:compare_command",
    },
    "public": {"lateral": "analysis", "compare": "comparison"},
    "page": {"Lateral": "page:lateral_page"},
    "study file": {"lateral analysis": "analysis:write_lateral"},
}
