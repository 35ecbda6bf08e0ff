"""Many cases at once: in a pool of processes or on a Dask cluster; a worker that dies loses nothing."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from typing import Any

from .._errors import ComputationError, InputError


PATIENCE = 3  # pools that may break one after another without a single case done
RETRIES = 2  # of a case that failed on a cluster's worker
TIMEOUT = 20  # s, for a scheduler to answer
FLAG = "--xla_cpu_multi_thread_eigen=false"
MOST = 61  # workers: Windows waits for no more processes at once
MANY = 4  # cores beyond which workers would crowd each other with threads


def run_all(work: Callable[[int], Any], jobs: Sequence[int], workers: int | None = None, scheduler: str | None = None
            ) -> Iterator[tuple[int, Any]]:
    """Do every job once and yield (job, result) as they are done, in any order.

    Args:
        work: a function that other processes can import (or a `functools.partial` of one).
        jobs: what to call it with.
        workers: processes; as many as there are cores if not given, none but this one for 1.
        scheduler: address of a Dask scheduler, whose workers do the jobs instead.

    Raises:
        InputError: no scheduler answers there, or dask.distributed is not installed.
        ComputationError: workers keep dying.
    """
    if scheduler is not None:
        return _run_on_cluster(work, jobs, scheduler) if jobs else iter(())
    workers = workers or _count_cores()
    return ((job, work(job)) for job in jobs) if workers == 1 else _run_in_pool(work, jobs, workers)


def _count_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run_in_pool(work: Callable[[int], Any], jobs: Sequence[int], workers: int) -> Iterator[tuple[int, Any]]:
    """On processes of this machine; where one is killed, what was in hand is done again by a new pool."""
    waiting, broken = list(jobs), 0
    while waiting:
        pool = ProcessPoolExecutor(min(workers, len(waiting), MOST), multiprocessing.get_context("spawn"), _settle)
        try:
            futures = {pool.submit(work, job): job for job in waiting}
            for future in as_completed(futures):
                result = future.result()
                waiting.remove(futures[future])
                broken = 0
                yield futures[future], result
        except BrokenProcessPool:
            broken += 1
            if broken == PATIENCE:
                raise ComputationError(f"worker processes died {PATIENCE} times without finishing a case (is there "
                                       "memory enough? try fewer --workers); the same command goes on") from None
        except BaseException:  # stopped by the user, or by whoever reads the results
            for process in multiprocessing.active_children():
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=not waiting, cancel_futures=True)


def _settle() -> None:
    """Make a worker quiet: few threads, no traceback when the user stops the command, no life after its parent."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    flags = os.environ.get("XLA_FLAGS", "")
    # With the flag programs are compiled anew: those that other commands left in the cache are without.
    if _count_cores() > MANY and FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {FLAG}".strip()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow(parent: int) -> None:
        connection.wait([parent])
        os._exit(1)

    if parent is not None:
        threading.Thread(target=follow, args=(parent.sentinel,), daemon=True).start()


def _run_on_cluster(work: Callable[[int], Any], jobs: Sequence[int], scheduler: str) -> Iterator[tuple[int, Any]]:
    """On a Dask cluster, which hands a dead worker's jobs to others."""
    try:
        from distributed import Client
        from distributed import as_completed as as_done
    except ImportError:
        raise InputError("a cluster needs dask.distributed: pip install \"ddetumble[cluster]\"", option="--scheduler"
                         ) from None
    try:
        client = Client(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"no Dask scheduler answers at {scheduler!r} ({reason})", option="--scheduler") from None
    with client:
        futures = client.map(work, list(jobs), pure=False, retries=RETRIES)
        names = {future.key: job for future, job in zip(futures, jobs, strict=True)}
        for future in as_done(futures, loop=client.loop):
            if future.status == "error":
                error: Any = future.exception()
                reason = f"{type(error).__name__}: {error}"[:300]
                if isinstance(error, ModuleNotFoundError):
                    reason = f"its workers do not have {error.name}; install ddetumble there"
                raise ComputationError(f"case {names[future.key]} cannot be done on the cluster ({reason}); the same "
                                       "command goes on")
            yield names[future.key], future.result()
