"""One levitated axis under any controller: its unstable pole, gain and delay from u, y and time."""
