"""Whether a law holds: ``verdict`` is read first, then ``nominal``, ``robust`` and ``sampled``,
which give its rows; ``plants`` decides stability.
"""
