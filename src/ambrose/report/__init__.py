"""Results for people: ``page`` makes one of sections, ``plot`` a picture of any result; figures and
tables by subject.
"""
