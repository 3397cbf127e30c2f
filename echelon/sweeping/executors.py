"""Who carries out a sweep's runs: processes here, MPI ranks, or the workers of a Dask cluster.

All three are executors of `concurrent.futures`, and a sweep asks no more of them than `submit`. What differs is how
one comes to them, how many runs they take at a time, and what they do when a worker dies:

* **processes**: all that were computing are lost, and the pool is started anew (`Pool.restart`);
* **mpi**: the ranks of `mpiexec -n N`, of which the first leads and the others compute; MPI ends the whole job, and the
  same command goes on with it;
* **dask**: the cluster gives the run to another worker a few times, and then says that the run kills workers.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from importlib import import_module
from multiprocessing.connection import wait
from typing import Any, Literal

from echelon.errors import InputError

ExecutorName = Literal["processes", "mpi", "dask"]
EXECUTORS: tuple[ExecutorName, ...] = ("processes", "mpi", "dask")


class Pool:
    """An executor and what a sweep must know of it.

    Attributes:
        executor: Of `concurrent.futures`.
        width: How many runs it computes at a time.
        scratch: A folder for temporary files that goes when the sweep ends; None where workers may be elsewhere.
        broken: What a future raises when a worker died and took the whole executor with it.
        refused: What it raises when its own run has killed workers, and the executor lives on.
    """

    def __init__(
        self,
        executor: Executor,
        width: int,
        *,
        scratch: str | None = None,
        broken: tuple[type[BaseException], ...] = (),
        refused: tuple[type[BaseException], ...] = (),
        start: Callable[[], Executor] | None = None,
        kill: Callable[[], None] | None = None,
    ) -> None:
        self.executor, self.width, self.scratch = executor, width, scratch
        self.broken, self.refused = broken, refused
        self._start, self._kill = start, kill

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a call computed; raises one of `broken` where the executor is lost."""
        with _without_interrupts():
            return self.executor.submit(function, *arguments)

    def restart(self) -> None:
        """After a worker's death that broke the executor: start another in its place."""
        assert self._start is not None, "this executor does not break"
        self.executor.shutdown(wait=False, cancel_futures=True)
        self.executor = self._start()

    def abandon(self) -> None:
        """Stop at once; what is being computed is lost."""
        self.executor.shutdown(wait=False, cancel_futures=True)
        if self._kill is not None:
            self._kill()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """What is started in here never gets Ctrl-C, not even while it is being loaded; this process gets it later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def start_pool(name: ExecutorName, workers: int | None, dask_address: str | None = None) -> Iterator[Pool | None]:
    """The executor of that name; None in a process that is one of its workers, which has then done its work.

    Args:
        name: One of `EXECUTORS`.
        workers: How many; None takes a process for each core, or what there is.
        dask_address: Of a Dask scheduler that is already there; None starts a cluster of processes here.

    Raises:
        InputError: There is no such executor, what it needs is not installed, or the cluster is not there.
    """
    if name not in EXECUTORS:
        raise InputError(f"--executor {name}: must be one of {', '.join(EXECUTORS)}")
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: must be at least 1")
    if dask_address is not None and name != "dask":
        raise InputError(f"--dask-address {dask_address}: needs --executor dask")
    start = {"processes": _processes, "mpi": _mpi, "dask": _dask}[name]
    with start(workers, dask_address) as pool:
        yield pool


# ---- processes -------------------------------------------------------------------------------------------------------
@contextmanager
def _processes(workers: int | None, _: str | None) -> Iterator[Pool]:
    width = workers or os.cpu_count() or 1
    before = multiprocessing.active_children()

    def kill() -> None:
        for process in multiprocessing.active_children():
            if process not in before:
                process.terminate()

    def started() -> Executor:
        # Spawned, not forked: a copy of a process that has started Warp and its threads is not one that works.
        return ProcessPoolExecutor(width, multiprocessing.get_context("spawn"), _begin_worker)

    with tempfile.TemporaryDirectory(prefix="echelon-sweep-", ignore_cleanup_errors=True) as scratch:
        pool = Pool(started(), width, scratch=scratch, broken=(BrokenProcessPool,), start=started, kill=kill)
        try:
            yield pool
        except BaseException:
            pool.abandon()
            raise
        pool.executor.shutdown()


def _begin_worker() -> None:
    """A worker leaves Ctrl-C to the process that started it, and goes when that one is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "workers are started by a pool"

    def go_with_parent() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=go_with_parent, daemon=True).start()


# ---- MPI -------------------------------------------------------------------------------------------------------------
@contextmanager
def _mpi(workers: int | None, _: str | None) -> Iterator[Pool | None]:
    futures = _imported("mpi4py.futures", "mpi")
    world = _imported("mpi4py.MPI", "mpi").COMM_WORLD
    if world.size < 2:
        raise InputError(
            "--executor mpi: must be started by mpiexec with at least two processes, of which one leads, as in "
            "mpiexec -n 5 echelon sweep"
        )
    if workers is not None and workers != world.size - 1:
        raise InputError(
            f"--workers {workers}: must be left out with --executor mpi, where mpiexec says how many: "
            f"here {world.size - 1} and the one that leads"
        )
    with futures.MPICommExecutor(world, root=0) as executor:
        # None in all but the first rank, where it is entered only when there is no more work.
        yield None if executor is None else Pool(executor, world.size - 1)


# ---- Dask ------------------------------------------------------------------------------------------------------------
@contextmanager
def _dask(workers: int | None, address: str | None) -> Iterator[Pool]:
    distributed = _imported("distributed", "dask")
    scheduler = _imported("distributed.scheduler", "dask")
    with ExitStack() as stack:
        if address is None:
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=workers or os.cpu_count() or 1,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    host="127.0.0.1",
                )
            )
            client = stack.enter_context(distributed.Client(cluster))
        else:
            try:
                client = stack.enter_context(distributed.Client(address, timeout="10s"))
            except (OSError, ValueError, TypeError) as error:
                raise InputError(
                    f"--dask-address {address}: there is no Dask scheduler ({' '.join(str(error).split())})"
                ) from None
        there = len(client.nthreads())
        if there == 0:
            raise InputError(f"--dask-address {address}: the cluster has no workers")
        executor = stack.enter_context(client.get_executor(pure=False))
        yield Pool(executor, min(workers or there, there), refused=(scheduler.KilledWorker,))


def _imported(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except (ImportError, RuntimeError) as error:  # the latter where mpi4py finds no MPI
        raise InputError(
            f"--executor {extra}: {module.partition('.')[0]} cannot be imported ({' '.join(str(error).split())}); "
            f"`pip install 'echelon[{extra}]'` adds it"
        ) from None
