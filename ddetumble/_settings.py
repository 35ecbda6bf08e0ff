"""What every part relies on: JAX in 64 bits with a compilation cache on disk, how much memory there is, and where the
shipped data are.
"""

import ctypes
import difflib
import gc
import logging
import os
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ._errors import InputError


PROGRAM = "-program"  # how the names of traced programs end, which `inference.programs` keeps beside JAX's own
_OFF = ("off", "0", "no", "false")
_SHARE = 0.5  # of the machine's memory: what else the process holds, and other processes, have the rest
_UNKNOWN = 8e9  # bytes, of a machine that does not say what it has
# Linux gives a process 65,530 memory mappings, each compiled program takes some, and XLA aborts when they run out.
_MAPPINGS, _MOST = Path("/proc/self/maps"), 20_000
_PAGES = Path("/proc/self/statm")  # memory of this process, in pages: what is mapped, what is resident ...
# What a loop may touch to become one kernel [bytes]: any amount, as the solver makes its loops small enough itself.
_LOOPS, _ANY_SIZE = "--xla_backend_extra_options", "xla_cpu_small_while_loop_byte_threshold=1000000000"
_configured = False


def configure() -> None:
    """Set JAX up once: 64-bit floats, and compiled programs kept in the user's cache folder.

    Called by the subpackages that use JAX, before they define anything. What the user has set by JAX's own environment
    variables or in `jax.config` stays. A folder that cannot be written switches the cache off and is no error.
    """
    global _configured
    if _configured:
        return
    _configured = True
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.__version_info__ < (0, 11) and _LOOPS not in os.environ.get("XLA_FLAGS", ""):
        # XLA reads it when it starts. Older versions make one kernel of a loop in time only where they are told to:
        # otherwise tumbling bodies take up to ten times as long.
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_LOOPS}={_ANY_SIZE}".strip()
    # Where a program breaks down inside, JAX logs a traceback before it raises; whoever catches the error says why.
    logging.getLogger("jax._src.callback").setLevel(logging.CRITICAL)
    if _cache_is_off():
        return
    if getattr(jax.config, "jax_compilation_cache_dir", None) is None or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        folder = find_cache()
        jax.config.update("jax_compilation_cache_dir", str(folder) if _is_writable(folder) else None)
    for name, value in (
        ("jax_persistent_cache_min_compile_time_secs", 0.0),
        ("jax_persistent_cache_min_entry_size_bytes", -1),
    ):
        if name.upper() not in os.environ:
            jax.config.update(name, value)
    # A process killed while writing leaves half an entry: JAX then compiles again, which is all there is to do.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")


def find_platform() -> str:
    """What a program will run on, in the words of `jax.export`: `jax.default_device` may say another than the first."""
    import jax
    from jax import export

    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    name = getattr(chosen, "platform", chosen)
    return "cpu" if name == "cpu" else export.default_export_platform()


def forget_programs() -> None:
    """Forget compiled programs where a process holds many, so that hundreds of campaigns can follow each other in it.

    Those that are still wanted are read from the cache on disk again. Many are more than Linux has mappings for, or
    than fit into the process's part of the allowed memory, were there one for every core.
    """
    crowded = _MAPPINGS.exists() and _MAPPINGS.read_bytes().count(b"\n") > _MOST
    if crowded or measure_resident() > find_memory() / (os.cpu_count() or 1):
        import jax

        jax.clear_caches()
        gc.collect()
        trim_heap()


def measure_resident() -> float:
    """Memory that this process holds [bytes]; 0 where the system does not say."""
    try:
        return float(_PAGES.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return 0.0


def trim_heap() -> None:
    """Give memory back that is free in the C library's heap: glibc keeps what compiling leaves, some 100 MB each."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library, which has no such function
            ctypes.CDLL("libc.so.6").malloc_trim(0)


def find_cache() -> Path:
    """Folder of the compiled programs: JAX_COMPILATION_CACHE_DIR, or `ddetumble/jax` in the user's cache folder."""
    chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if chosen:
        return Path(chosen).expanduser()
    import platformdirs

    return Path(platformdirs.user_cache_dir("ddetumble", appauthor=False)) / "jax"


def clear_cache() -> tuple[int, int]:
    """Remove the compiled programs; returns how many there were and their size [bytes]. Other files stay."""
    entries = list_cache()
    size = sum(entry.stat().st_size for entry in entries)
    for entry in entries:
        entry.unlink(missing_ok=True)
    return sum(entry.name.endswith("-cache") for entry in entries), size


def list_cache() -> list[Path]:
    """Everything that is kept in the cache folder: JAX's entries end in `-cache`, their times of use in `-atime`, and
    traced programs in `-program`."""
    folder = find_cache()
    if not folder.is_dir():
        return []
    return sorted(entry for entry in folder.iterdir() if entry.name.endswith(("-cache", "-atime", PROGRAM)))


def find_data() -> Path:
    """Find the folder of the shipped data: `data/` of a checkout, `ddetumble/_data` where a wheel is installed."""
    package = Path(__file__).resolve().parent
    installed = package / "_data"
    return installed if installed.is_dir() else package.parent / "data"


def list_shipped() -> list[str]:
    """Names of the campaigns that come with the toolkit."""
    data = find_data()
    return sorted(path.parent.relative_to(data).as_posix() for path in data.glob("**/records.csv"))


def locate_campaign(path: str | Path) -> Path:
    """Path of a campaign: as given, or, where there is nothing, of the shipped campaign of that name.

    Raises:
        InputError: Neither is there.
    """
    given = Path(path)
    if given.exists() or given.is_absolute() or given.suffix == ".json":
        return given
    if (find_data() / given / "datapackage.json").is_file():
        return find_data() / given
    shipped = list_shipped()
    near = [name for name in shipped if name.rpartition("/")[2] == given.as_posix()]
    parent = given.parent
    beside = sorted(one.name for one in parent.iterdir() if one.is_dir()) if parent.is_dir() else []
    alike = difflib.get_close_matches(given.name, beside, n=1)
    raise InputError(f"this folder does not exist; did you mean {near[0]}, which comes with the toolkit?" if near else
                     f"this folder does not exist; did you mean {parent / alike[0]}?" if alike else
                     f"this folder does not exist; check the path, or name a campaign that comes with the toolkit: "
                     f"{', '.join(shipped)}",
                     file=str(path))


def name_folder(folder: Path) -> str:
    """A folder as commands take it: from the working folder on, or from the shipped data on; else as it was given."""
    for start in (Path.cwd(), find_data()):
        if folder.resolve().is_relative_to(start.resolve()):
            return folder.resolve().relative_to(start.resolve()).as_posix()
    return str(folder)


def find_memory() -> float:
    """Memory that one computation may take [bytes]: DDETUMBLE_MEMORY, such as `4 GB`, or half of the machine's."""
    chosen = os.environ.get("DDETUMBLE_MEMORY", "").strip()
    if not chosen:
        return _SHARE * _measure_machine()
    size = re.fullmatch(r"(\d+\.?\d*)\s*([MGT])i?B", chosen)
    if size is None:
        raise InputError(f"the value {chosen!r} is not a size; give one such as 4 GB", file="DDETUMBLE_MEMORY")
    return float(size[1]) * {"M": 1e6, "G": 1e9, "T": 1e12}[size[2]]


def refuse_memory(size: float, what: str) -> None:
    """Raise `InputError` where `what` (the subject of a sentence) would take more memory [bytes] than is allowed."""
    allowed = find_memory()
    if size > allowed:
        raise InputError(f"{what} would take about {size / 1e9:.2g} GB of memory, but only {allowed / 1e9:.2g} GB are "
                         "allowed (DDETUMBLE_MEMORY, by default half of the machine's memory): use fewer records, or "
                         "every n-th sample of them, or allow more")


@contextmanager
def reserve_memory(size: float, what: str) -> Iterator[None]:
    """Wait until what runs beside it leaves so much of the allowed memory; arguments as of `refuse_memory`."""
    global _reserved
    refuse_memory(size, what)
    with _room:
        _room.wait_for(lambda: not _reserved or _reserved + size <= find_memory())
        _reserved += size
    try:
        yield
    finally:
        with _room:
            _reserved -= size
            _room.notify_all()


_room, _reserved = threading.Condition(), 0.0


def _measure_machine() -> float:
    """Memory of the machine, or less where the process is held to less [bytes]."""
    found = []
    with suppress(AttributeError, ValueError, OSError):
        found.append(float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES"))
    if sys.platform == "win32":
        import ctypes

        kilobytes = ctypes.c_ulonglong()
        if ctypes.windll.kernel32.GetPhysicallyInstalledSystemMemory(ctypes.byref(kilobytes)):
            found.append(1024.0 * kilobytes.value)
    for place in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError):  # `max` where there is no limit
            found.append(float(int(Path(place).read_text())))
    with suppress(ImportError, AttributeError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        found += [] if limit == resource.RLIM_INFINITY else [float(limit)]
    return min(found, default=_UNKNOWN)


def describe_cache() -> str:
    """One line for people: where the cache is, whether it is on, and how much it holds."""
    folder = find_cache()
    if _cache_is_off():
        return f"The compilation cache is off (DDETUMBLE_CACHE); its folder would be {folder}"
    entries = list_cache()
    programs = sum(entry.name.endswith("-cache") for entry in entries)
    size = sum(entry.stat().st_size for entry in entries) / 1e6
    return f"{folder}: {programs} compiled programs, {size:.1f} MB"


def _cache_is_off() -> bool:
    return os.environ.get("DDETUMBLE_CACHE", "").strip().lower() in _OFF


def _is_writable(folder: Path) -> bool:
    """Make the folder if need be, and say whether files can be put there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK) or sys.platform == "win32"
