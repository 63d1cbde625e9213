"""The structured singular value: ``bounds`` and their peak, ``lower``, ``upper``, and a level
proved at all frequencies.
"""
