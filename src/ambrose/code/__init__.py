"""Controllers as files for targets. ``pipeline`` is read first: sampled, judged, written; a target
is a class in ``targets``; what a step takes in ``interface``, C in ``c``, the block that all share
in ``block``, trials on a processor in ``processor_build`` and ``processor_trial``.
"""
