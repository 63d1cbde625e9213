"""LPV synthesis: ``synthesis`` on a grid, ``machine`` for the plants of a machine, ``method`` as
chosen.
"""
