"""One controller of fixed order for all operating points: ``tuning`` is read first, ``objective``
is what it minimises, ``polish`` refines another method's.
"""
