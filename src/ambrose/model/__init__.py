"""Physics and plant: ``assemble`` makes it from the ``effects``, ``uncertainty`` reduces it and
keeps its tolerances.
"""
