"""The chain of stages, machine file to report: ``study``, ``commissioning``, ``new_machine``, and
``check`` of a machine file.
"""
