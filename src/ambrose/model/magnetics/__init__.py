"""Magnets from their geometry: a network of gaps, iron, coils and permanent magnets."""
