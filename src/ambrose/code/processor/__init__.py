"""Code on its own processor: cross-compiled, run by an emulator, compared with this computer."""
