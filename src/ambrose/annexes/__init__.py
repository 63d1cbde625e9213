"""Rooms that can be taken off: each registers what it adds in one table (``ambrose.registry``)."""
