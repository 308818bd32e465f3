"""One function over many tasks: in this process, over a pool of processes, or over a Dask cluster.

Which of them is a setting of the machine, never of a request: ``SMOKEGLINT_FAN_OUT`` is empty (here, one after the
other), ``processes:4`` or ``dask:tcp://scheduler:8786``. The function is pure and importable, so all three give the
same results, in the order of the tasks.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from shared.errors import SmokeglintError
from shared.lifeline import end_with_parent

VARIABLE = "SMOKEGLINT_FAN_OUT"
_TRIES = 3
_LOOK_S, _LONELY_S = 5.0, 120.0
Result = TypeVar("Result")


def fan_out(function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]) -> list[Result]:
    """``[function(*task) for task in tasks]``, spread as the machine is set up.

    A worker that dies costs a retry of what it held; SmokeglintError after three tries, or if the setting is bad.
    What the function raises is raised here.
    """
    return list(fan_out_in_turn(function, tasks))


def fan_out_in_turn(function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
    """The same one result after the other, in order: for results that should not all be held at once."""
    kind, _, value = os.environ.get(VARIABLE, "").partition(":")
    if not kind:
        return (function(*task) for task in tasks)
    if kind == "processes" and value.isdigit() and int(value) > 0:
        return _over_processes(function, tasks, int(value))
    if kind == "dask" and value:
        return _over_dask(function, tasks, value)
    raise SmokeglintError(
        f"{VARIABLE} is '{kind}:{value}'; accepted: empty, 'processes:N' (N at least 1) or 'dask:tcp://host:port'."
    )


def _over_processes(
    function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], workers: int
) -> Iterator[Result]:
    """Spawned processes that end with this one; a broken pool is replaced and goes on where it stood."""
    spawn = multiprocessing.get_context("spawn")
    done = 0
    for _ in range(_TRIES):
        pool = ProcessPoolExecutor(workers, spawn, initializer=end_with_parent, initargs=(os.getpid(),))
        try:
            ahead: list[Future[Result]] = []
            for position in range(done, len(tasks)):
                while len(ahead) < 2 * workers and position + len(ahead) < len(tasks):
                    ahead.append(pool.submit(function, *tasks[position + len(ahead)]))
                yield ahead.pop(0).result()
                done += 1
            return
        except BrokenProcessPool:
            continue
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    raise SmokeglintError(f"Task {done + 1} of {len(tasks)} killed its worker process {_TRIES} times.")


def _over_dask(function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], address: str) -> Iterator[Result]:
    from distributed import Client
    from distributed.scheduler import KilledWorker

    with Client(address, timeout=10, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        futures = [client.submit(function, *task, pure=False, retries=0) for task in tasks]
        try:
            while futures:
                yield _result(client, futures[0])
                futures.pop(0)  # the cluster may forget it
        except KilledWorker as error:
            raise SmokeglintError(f"A task killed its Dask workers again and again: {error}") from error


def _result(client: Any, future: Any) -> Any:
    """A result, however long it takes; SmokeglintError once the cluster has had no worker for two minutes."""
    lonely_since = None
    while True:
        try:
            return future.result(timeout=_LOOK_S)
        except TimeoutError:
            if client.nthreads():
                lonely_since = None
                continue
            lonely_since = lonely_since or time.monotonic()
            if time.monotonic() - lonely_since > _LONELY_S:
                raise SmokeglintError("The Dask cluster has lost all of its workers.") from None
