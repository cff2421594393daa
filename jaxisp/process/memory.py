"""Memory that is freed: kept, so that a large frame does not get it from the system at every call.

Or given back, with that of programs that are needed no more.

XLA takes the scratch of a program from the C library at each call. glibc gives blocks above 32 MB, and
much of what threads free, back to the system; it comes again a page at a time, at 1 to 3 us each. A library
should not change that by itself: a program that calls something many times on large frames calls
`keep_freed()` before it computes.
"""

import ctypes
import gc
import platform
from collections.abc import Hashable

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


MOST_SIZES = 8
"""Sizes of pictures that a walk over files keeps programs of: those of a recipe take 6 to 42 MB a size."""


def forget_compiled() -> None:
    """Forget all compiled programs and traces of this process, and give their memory back to the system.

    A program belongs to one size of pictures. A loop over files of many sizes calls this now and then. What
    is needed again is compiled again, or read where programs are kept (`keep_compiled`). Arrays stay.
    `jax.clear_caches()` alone frees the memory too, but glibc does not give it back.

    Example:
        >>> import jaxisp
        >>> jaxisp.forget_compiled()
    """
    import jax  # here, as `keep_freed` is best called before

    jax.clear_caches()
    gc.collect()
    give_back()


def forget_beyond(sizes: set[Hashable], size: Hashable) -> None:
    """Note that pictures of this size come next; `forget_compiled` where `MOST_SIZES` others came before.

    Args:
        sizes: those since programs were last forgotten; changed here.
        size: of the pictures that come.
    """
    if size not in sizes and len(sizes) >= MOST_SIZES:
        forget_compiled()
        sizes.clear()
    sizes.add(size)
