"""Runs of a scenario: ``trial`` takes any machine and law, ``virtual_rig`` is nonlinear, ``linear``
is not.
"""
