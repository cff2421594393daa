"""Compiled programs kept on disk, so that the second start of a program does not compile again.

JAX keeps none unless told to, and a library should not tell it at import. The command line does;
a program of your own calls `keep_compiled()` before it computes, or sets JAX_COMPILATION_CACHE_DIR.
"""

import hashlib
import os
import platform
import warnings
from pathlib import Path

from jaxisp.process.environment import no_false_errors

SWITCH = "JAXISP_CACHE"
"""Environment variable: "off" keeps nothing, a path is kept in instead of the user's cache folder."""
SHORTEST = 0.2
"""Seconds that compiling must take for the program to be kept."""


def cache_folder() -> Path | None:
    """Where compiled programs are kept on this machine; None where that is switched off, or nowhere."""
    chosen = os.environ.get(SWITCH, "")
    if chosen.lower() in ("off", "0", "no", "false"):
        return None
    base = Path(chosen) if chosen else user_cache()
    return base / f"programs-{_processor()}" if base else None


def user_cache() -> Path | None:
    """The user's folder for what can be made or fetched again; None for a user without a home."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(home):  # which the standard has ignored
        home = os.path.expanduser("~/.cache")
    return Path(home) / "jaxisp" if os.path.isabs(home) else None


def keep_compiled(folder: str | Path | None = None) -> Path | None:
    """Let JAX keep compiled programs, for the whole process. What is set already stays as it is.

    Best called before JAX is imported: after that, XLA's messages about programs that it loads, which speak
    of errors and are none, cannot be kept from standard error.

    Args:
        folder: `cache_folder()` unless given.

    Returns:
        The folder that is used, or None where it is switched off or cannot be written.

    Example:
        >>> import jaxisp
        >>> folder = jaxisp.keep_compiled()
        >>> folder is None or folder.is_dir()
        True
    """
    no_false_errors()
    import jax

    # a process that was killed while it wrote one leaves it cut short: it is compiled again; as all are where
    # the folder cannot be used
    warnings.filterwarnings("ignore", "Error (read|writ)ing persistent compilation cache entry", UserWarning)
    if already := jax.config.values["jax_compilation_cache_dir"]:
        return Path(already)
    found = cache_folder() if folder is None else Path(folder)
    if found is None or not _writable(found):
        return None
    jax.config.update("jax_compilation_cache_dir", str(found))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
    return found


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _processor() -> str:
    """A name for it: machines that share a home need not have the same instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.processor()]
    features = sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})
    text = "\n".join(features or lines)
    return f"{platform.machine()}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
