"""The lateral analysis that a machine is bought on: unbalance response, clearances, stability and
capacity, clause by clause.
"""

ANNEX = {
    "design command": {"lateral": "command:lateral_command"},
    "public": {"lateral": "analysis"},
    "page": {"Lateral": "page:lateral_page"},
}
