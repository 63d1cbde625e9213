"""Measured signals: ``record`` is the noun, ``files`` reads and writes by suffix, ``foreign`` what
other programs left.
"""
