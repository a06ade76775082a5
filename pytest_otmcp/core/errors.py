"""The kit's own exceptions; the type says whose fault it is.

::

    Exception
    ├── UsageError      the user's: a bad option or file; one sentence, exit code 2
    ├── KitError        ours: a mock died, the plant could not start; the verdict becomes INDETERMINATE
    │   ├── ExhaustedError    the machine's: it has no descriptors, memory, processes or disk left, or another program has
    │   │                     taken a port of a mock; one sentence that helps
    │   └── MeddledError      somebody's: a part of the kit was killed, stopped or kept from its work, and nobody can show by whom
    ├── SubjectError    the adapter's: it could not start or serve; becomes a Finding, never a traceback
    └── NoBindingError  the subject file's: it does not say how to ask for something that it claims; the item is not testable

A fault of the adapter found by an oracle is no exception at all but a :class:`~pytest_otmcp.core.finding.Finding`.
"""

from __future__ import annotations

from pathlib import Path

from .text import marked

__all__ = [
    "ExhaustedError",
    "KitError",
    "MeddledError",
    "NoBindingError",
    "NoHandleError",
    "SubjectError",
    "UsageError",
    "place_of",
]


class UsageError(Exception):
    """A request of the user cannot be carried out; the message says what, where and what to do."""


class KitError(Exception):
    """The kit or its plant failed. Never the adapter's fault; please file a bug."""


class ExhaustedError(KitError):
    """The machine of the kit has run out of something, or has given a mock's port away; the message says what helps. No bug, so none
    is to be filed."""


class MeddledError(KitError):
    """Somebody has killed or stopped a part of the kit, or keeps it from its work: the adapter may have done so, and nobody can show it.
    No bug, so none is to be filed."""


class SubjectError(Exception):
    """The adapter under test could not be started or served; the message repeats its words, each line of them marked.

    Attributes:
        code: the finding's code, such as ``cannot_start`` or ``start_timeout``.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(marked(message))
        self.code = code


class NoBindingError(Exception):
    """The subject claims something but does not say how to ask for it: the item is not testable."""


class NoHandleError(NoBindingError):
    """A call takes a handle that no earlier call of the session has yielded."""


def place_of(error: Exception) -> str:
    """Return the file and line at which an exception was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "an unknown place" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
