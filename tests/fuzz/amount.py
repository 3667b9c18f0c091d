"""How much the long tests of this folder do, and how they damage what they have.

``PDGW_FUZZ_INPUTS``: inputs of each long test; ``PDGW_FUZZ_SEED``: another seed, other inputs. ``make fuzz INPUTS=... SEED=...``
sets both.
"""

from __future__ import annotations

import os
import random

INPUTS = int(os.environ.get("PDGW_FUZZ_INPUTS", "2000"))
"""Damaged inputs of each long test."""
SEED = int(os.environ.get("PDGW_FUZZ_SEED", "1"))


def damage(data: bytes, chance: random.Random, start: int = 0) -> bytes:
    """Change a few bytes after ``start``, cut, extend or repeat a piece."""
    out = bytearray(data)
    for _ in range(chance.randrange(4)):
        at = chance.randrange(min(start, len(out) - 1), len(out))
        out[at] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256), out[at] ^ 1 << chance.randrange(8)))
    kind = chance.randrange(8)
    if kind == 0:
        del out[chance.randrange(len(out)) :]
    elif kind == 1:
        out += chance.randbytes(chance.randrange(64))
    elif kind == 2:
        at = chance.randrange(len(out))
        out[at:at] = out[chance.randrange(len(out)) :][:40]
    return bytes(out)
