"""A rotor and a controller of others, reviewed for a customer: one page, ready to sign, and the
pages behind it.
"""

ANNEX = {
    "design command": {"review": "review:review_command"},
    "public": {"review": "review"},
    "page": {"Review": "review:review_page"},
}
