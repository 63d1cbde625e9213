"""What is written down, checked and without matrices: ``description`` and its parts, files in
``file``, the physics in ``validation``.
"""
