"""Seals from records: ``pipeline`` over pressures, ``by_frequency`` from sines."""
