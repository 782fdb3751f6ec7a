"""What the command line sets for its whole process before JAX is imported: a library must not, the user's own stays."""

import atexit
import contextlib
import gc
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

# XLA compiles a while loop that carries up to so many bytes without a task for each operation in it. It ignores the
# name of an option that it does not have. Not set is xla_cpu_use_multi_output_fusion, which would halve the compile
# time of derivatives: jaxlib 0.10.2 ends the process where it compiles those of the fields.
_XLA_OPTIONS = "xla_cpu_small_while_loop_byte_threshold=1000000"
_LARGEST_CACHE = 2**30  # bytes
_PATIENCE = 2.0  # seconds after Ctrl-C


def prepare(cached: bool) -> None:
    """Has JAX start, trace and compile faster, and if `cached` keep what is compiled for the processes to come."""
    if "jax" in sys.modules:
        return  # it has read its environment
    gc.set_threshold(100_000, 20, 20)  # tracing makes many objects and little garbage
    atexit.register(gc.freeze)  # or the interpreter would look for garbage in all of JAX before it ends
    flags = os.environ.get("XLA_FLAGS", "")
    if not flags or flags.startswith("--"):  # and not the name of a file with flags
        os.environ["XLA_FLAGS"] = f"--xla_backend_extra_options={_XLA_OPTIONS} {flags}".rstrip()
    if not cached:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    elif (folder := _cache_folder()) is not None:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        from ..scene import units

        units.cache_folder = folder


def _cache_folder() -> Path | None:
    """The user's cache folder, emptied if it has grown too large; None where nothing can be written."""
    import platformdirs

    folder = platformdirs.user_cache_path("cosserat-jax", appauthor=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if sum(file.stat().st_size for file in folder.iterdir()) > _LARGEST_CACHE:
            shutil.rmtree(folder)
            folder.mkdir()
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Has Ctrl-C end the process within two seconds. While XLA compiles or computes, Python's own handler waits for it
    to end; so the C-level one writes to a pipe, at whose other end a thread stands."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    over = threading.Event()

    def watch() -> None:
        while number := os.read(read, 1):
            if number[0] == signal.SIGINT and not over.wait(_PATIENCE):
                os.write(
                    2,
                    b"\n" * os.isatty(2) + b"cosserat-jax: stopped; a sweep with --out continues with --resume\n",
                )
                os._exit(130)

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        os.close(write)
