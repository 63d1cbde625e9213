"""What a machine must fulfil: ``machine`` calls the others; ``ranges.toml`` holds every key."""
