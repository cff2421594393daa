"""Memory that is freed and kept: a large frame does not get it from the system at every call.

XLA takes the scratch of a program from the C library at each call. glibc gives blocks above 32 MB, and
much of what threads free, back to the system; it comes again a page at a time, at 1 to 3 us each. A library
should not change that by itself: a program that calls something many times on large frames calls
`keep_freed()` before it computes.
"""

import ctypes
import platform

# glibc's malloc.h
_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8
_MOST = 2**31 - 1


def keep_freed() -> bool:
    """Let the C library keep what is freed, up to 2 GB, in one pool for all threads, for the whole process.

    Worth it for gradients of frames of a megapixel and for all above, from ten or twenty calls on: until then
    blocks are cut and joined, and the process comes to hold several times its largest. Small batches
    may lose some percent. Best called before JAX is imported: threads that have a pool already keep it.

    Returns:
        Whether it took effect: False without glibc (macOS, Windows, musl), where nothing is changed.

    Example:
        >>> import jaxisp
        >>> jaxisp.keep_freed() in (True, False)
        True
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    settings = ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, _MOST), (_ARENA_MAX, 1))
    return all([mallopt(name, value) == 1 for name, value in settings])


def give_back() -> bool:
    """Give the system what is freed and still held by the C library.

    glibc keeps what was freed between blocks that are in use, in a pool for each thread. Between phases of
    work that differ in what they need, this can be more than what is used.

    Returns:
        Whether there was anything: False without glibc, where nothing is done.

    Example:
        >>> import jaxisp.process.memory
        >>> jaxisp.process.memory.give_back() in (True, False)
        True
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    return ctypes.CDLL(None).malloc_trim(0) == 1
