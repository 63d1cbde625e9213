"""The block that every target writes: ``block`` as numbers, ``run`` as behaviour, ``cascade``,
``scheduled`` and ``fixed_point`` as its kinds, the twin of synchronous blocks.
"""
