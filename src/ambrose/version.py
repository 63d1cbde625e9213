"""The version, in this one place: of the package, its metadata, and every file that it writes."""

__version__ = "1.0.0"
