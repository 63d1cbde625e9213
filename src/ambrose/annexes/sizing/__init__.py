"""How small magnets and amplifiers, how gentle a controller may be, and still guarantee what is
asked (thesis, 7.3).
"""

ANNEX = {
    "design command": {"size": "command:size"},
    "public": {"size": "least", "least": "least", "price": "least"},
    "page": {"Sizing": "page:sizing_page"},
}
