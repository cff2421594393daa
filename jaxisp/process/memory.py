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
from collections.abc import Callable, Hashable
from typing import Any

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
"""Sizes of pictures that a walk over files keeps programs of."""
FEW_SIZES = 2
"""Of so many, all that JAX keeps may stay."""


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


class Programs:
    """A function, compiled for each kind of arguments, of which nothing but the program is kept.

    JAX keeps beside a program what it was traced and lowered to. From the third program on that is forgotten,
    with all that others in the process have compiled (see `forget_compiled`). These
    programs are, where there are `MOST_SIZES`.

    Args:
        fn: of arrays and pytrees of them.
    """

    def __init__(self, fn: Callable[..., Any]) -> None:
        self._fn = fn
        self._kept: dict[Hashable, Callable[..., Any]] = {}

    def __call__(self, *args: Any) -> Any:
        import jax

        leaves, tree = jax.tree.flatten(args)
        kind = tree, tuple(map(jax.typeof, leaves))
        if kind not in self._kept:
            if len(self._kept) >= MOST_SIZES:
                self._kept.clear()
            self._kept[kind] = jax.jit(self._fn).lower(*args).compile()
            if len(self._kept) > FEW_SIZES:
                forget_compiled()
        return self._kept[kind](*args)


def forget_beyond(sizes: set[Hashable], size: Hashable) -> None:
    """Note that pictures of this size come next; `forget_compiled` where `MOST_SIZES` others came before.

    What compiling took for the sizes before is given back to the system: twice to three times the programs.

    Args:
        sizes: those since programs were last forgotten; changed here.
        size: of the pictures that come.
    """
    if size in sizes:
        return
    if len(sizes) >= MOST_SIZES:
        forget_compiled()
        sizes.clear()
    else:
        give_back()
    sizes.add(size)
