"""The kit's own event loop, on a thread of its own.

Conformance tests are plain functions; everything asynchronous runs on this loop. A vendor's asyncio settings
(``asyncio_mode``, loop scopes, policies) therefore never decide on which loop a session lives, and an anyio
cancel scope is always left by the task that entered it.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from concurrent.futures import CancelledError, Future
from contextvars import Context
from typing import Any, Generic, TypeVar

from ..core.errors import ExhaustedError
from ..core.exhaustion import exhausted

__all__ = ["LoopThread"]

T = TypeVar("T")

_CLEAN_UP_S = 60.0
"""Time for the clean-up after Ctrl-C: an adapter that ignores the end of its stdin and SIGTERM is killed after two grace
periods. A second Ctrl-C ends the wait."""


class _Job(Generic[T]):
    """Work for the loop, on which ``begin`` and ``cancel`` are called.

    Attributes:
        result: what the work returns or raises; cancelled when the work is.
        ended: the work has ended, or will never begin.
    """

    def __init__(self, work: Coroutine[object, object, T]) -> None:
        self.result: Future[T] = Future()
        self.ended = threading.Event()
        self._work = work
        self._task: asyncio.Task[T] | None = None

    def begin(self) -> None:
        # The work runs in a context of its own: the context of a test would tell anyio that this is trio's thread, or hand
        # a vendor's variables to the sessions of the kit.
        self._task = asyncio.get_running_loop().create_task(self._work, context=Context())
        self._task.add_done_callback(self._end)

    def cancel(self) -> None:
        if self._task is not None:
            self._task.cancel()
        else:
            self._work.close()
            self.ended.set()

    def _end(self, task: asyncio.Task[T]) -> None:
        if task.cancelled():
            self.result.cancel()
        elif (error := task.exception()) is not None:
            self.result.set_exception(error)
        else:
            self.result.set_result(task.result())
        self.ended.set()


class LoopThread:
    """Event loop that runs until :meth:`close`."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(self._note_exhaustion)
        self._exhaustion: str | None = None
        self._thread = threading.Thread(target=self._serve, name="otmcp-loop", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_forever()
        finally:
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            asyncio.set_event_loop(None)
            self._loop.close()

    def _note_exhaustion(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Keep what no task has handled, where it is the machine's fault: a tap that cannot accept a connection, for instance,
        tells nobody else, and its silence would be held against the adapter."""
        cure = exhausted(context["exception"]) if isinstance(context.get("exception"), Exception) else None
        if cure is None:
            loop.default_exception_handler(context)
        else:
            self._exhaustion = cure

    def check(self) -> None:
        """Tell what the machine has run out of since the last time that this was asked.

        Raises:
            ExhaustedError: it has.
        """
        cure, self._exhaustion = self._exhaustion, None
        if cure is not None:
            raise ExhaustedError(cure)

    def run(self, work: Coroutine[object, object, T]) -> T:
        """Run ``work`` on the loop and return its result.

        When the waiting thread is interrupted (Ctrl-C), the work is cancelled and gets time to clean up before the
        interrupt goes on, because it may have processes to end.
        """
        job = _Job(work)
        try:
            self._loop.call_soon_threadsafe(job.begin)
            return job.result.result()
        except KeyboardInterrupt:
            # It may have come before the work was handed over; what is handed over first is done first.
            self._loop.call_soon_threadsafe(job.cancel)
            job.ended.wait(_CLEAN_UP_S)
            raise
        except CancelledError:
            raise KeyboardInterrupt from None

    def _submit(self, work: Coroutine[object, object, T]) -> Future[T]:
        # See :class:`_Job` for the context.
        return Context().run(asyncio.run_coroutine_threadsafe, work, self._loop)

    async def wait(self, work: Coroutine[object, object, T]) -> T:
        """Run ``work`` on the loop and await its result from any other event loop, asyncio's or trio's.

        When the waiting task is cancelled, the work is cancelled too, except under trio: it has no futures to cancel, so
        the work goes on.
        """
        future = self._submit(work)
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            from anyio import to_thread

            return await to_thread.run_sync(future.result, abandon_on_cancel=True)
        return await asyncio.wrap_future(future)

    def close(self) -> None:
        """Cancel all tasks of the loop and end the thread."""
        if self._loop.is_closed():
            return
        asyncio.run_coroutine_threadsafe(self._cancel_all(), self._loop).result(timeout=10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=10.0)

    @staticmethod
    async def _cancel_all() -> None:
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
