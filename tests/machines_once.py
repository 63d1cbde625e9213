"""Machine files that are read again and again are read once by each process: 200 tests of one room
read 64 different texts, 240 times. A machine changes no more than a number does.
"""

from functools import lru_cache

from ambrose.machine.attachment import attachments
from ambrose.machine.file import toml as reader

LONGEST = 100_000  # characters; longer ones are tests of what a file may hold


def install():
    """In place of ``loads_machine``, which ``load_machine`` calls. What is refused is read again,
    and a text under other registered effects is another one.
    """
    own = reader.loads_machine
    once = lru_cache(maxsize=128)(lambda text, name, effects: own(text, name))

    def loads_machine(text, name="machine file"):
        if not isinstance(text, str) or len(text) > LONGEST:
            return own(text, name)
        return once(text, name, tuple(attachments()))

    reader.loads_machine = loads_machine
