"""What is decided by hashes: halves, orders, seeds. The same names give the same choice everywhere."""

import zlib

DEVELOP, SEALED = HALVES = ("develop", "sealed")


def order(*words: str) -> int:
    """A number by which things are shuffled."""
    return zlib.crc32(" ".join(words).encode())


def half_of(*words: str) -> str:
    """Which half something belongs to: bits of a hash beside those that orders start with."""
    return HALVES[zlib.crc32(" ".join(("half", *words)).encode()) >> 7 & 1]
