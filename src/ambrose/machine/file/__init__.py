"""Machine files and what becomes one: ``toml`` is read first, then ``tables``; ``ross`` and
``stations`` read the rotors of others, ``update`` writes a change into a user's file.
"""
