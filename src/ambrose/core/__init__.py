"""Mathematics without a rotor word: numpy, scipy and threadpoolctl only."""
