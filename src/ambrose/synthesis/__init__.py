"""Designs: ``design`` is read first, ``methods`` are chosen from; the mathematics of each in its
file.
"""
