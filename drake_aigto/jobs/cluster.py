"""Workers of a Dask scheduler as an executor."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor

from distributed import Client, Security, rpc
from distributed.cfexecutor import ClientExecutor
from distributed.versions import get_package_info

from drake_aigto.errors import StudyError
from drake_aigto.progress import log_from

# How long a scheduler may take to answer. [s]
_PATIENCE = 5.0
# Versions that have to agree, so that plans are the same on all machines.
_PACKAGES = ("drake_aigto", "drake")


class _Dask(ClientExecutor):
    """Dask's executor, shut down with the arguments that all others take."""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Waits for all jobs, or for none, and cancels those that it does not wait for."""
        super().shutdown(wait and not cancel_futures)  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def connect(address: str) -> Iterator[Executor]:
    """Yields the workers of a scheduler after checking them.

    Raises:
        StudyError: it does not answer, or has no workers, or one that is not fit.
    """
    name = f"Dask scheduler {address}"
    try:
        # A client would wait for ever for one that takes the call and says nothing. In a thread, as
        # there may be a loop in this one (Jupyter).
        with ThreadPoolExecutor(1) as thread:
            asked = thread.submit(asyncio.run, asyncio.wait_for(_ask(address), _PATIENCE))
            threads, versions = asked.result()
    except (OSError, TypeError, ValueError, asyncio.TimeoutError) as error:
        raise StudyError(
            f"{name} does not answer",
            got=str(error) or f"nothing within {_PATIENCE:g} s",
            remedy="Start one (dask scheduler), and give the address that it tells.",
        ) from error
    if not threads:
        raise StudyError(name, got="no workers", expected="some", remedy=_how_to_start(address))
    for worker in sorted(threads.keys() & versions.keys()):
        _check_worker(worker, threads[worker], versions[worker], address)
    # The loss of a scheduler shows in its jobs, and Drake gives the root logger a handler.
    quiet = log_from(logging.CRITICAL, "distributed")
    with quiet, Client(address, timeout=_PATIENCE, set_as_default=False) as client:
        yield _Dask(client, pure=False)


async def _ask(address: str) -> tuple[dict[str, int], dict[str, dict[str, str | None]]]:
    """Returns how many threads each worker of a scheduler has, and which packages."""
    security = Security().get_connection_args("client")
    async with rpc(address, connection_args=security) as scheduler:
        workers = (await scheduler.identity())["workers"]
        ask = {"op": "versions", "packages": _PACKAGES}
        versions = await scheduler.broadcast(msg=ask)
    threads = {worker: each["nthreads"] for worker, each in workers.items()}
    return threads, {worker: each["packages"] for worker, each in versions.items()}


def _check_worker(
    worker: str, threads: int, packages: Mapping[str, str | None], scheduler: str
) -> None:
    """Refuses a worker that would plan otherwise than this process, or measure other times."""
    here = get_package_info(_PACKAGES)
    for package in _PACKAGES:
        if packages[package] != here[package]:
            raise StudyError(
                f"Dask worker {worker}",
                got=f"{package} {packages[package] or 'missing'}",
                expected=f"{here[package]}, as here",
                remedy="Install the same there.",
            )
    if threads != 1:
        raise StudyError(
            f"Dask worker {worker}",
            got=f"{threads} threads",
            expected="one, as the CPU time of its process is measured",
            remedy=_how_to_start(scheduler),
        )


def _how_to_start(scheduler: str) -> str:
    return f"Start workers so: dask worker {scheduler} --nworkers N --nthreads 1."
