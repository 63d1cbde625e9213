"""Records to values with intervals: ``pipeline`` is read first, then ``loop``; ``record_check``
says what a record serves for.
"""
