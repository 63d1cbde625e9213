"""Least squares in closed loop: ``closed_loop`` is read first, ``normal_equations`` and
``periodic`` are its two ways to a step.
"""
