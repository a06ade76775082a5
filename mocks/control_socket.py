"""The Unix socket of a device's control channel, in a directory that only this user can enter.

A process that reaches the control channel can change what the device reports. Therefore the channel is no port, which
every process of the machine and every container that shares the network could find and use. Only the ready line has its
path: it is in no command line, in no environment and not in the kernel's list of sockets (``/proc/net/unix``).
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import socket
import tempfile

__all__ = ["ControlSocket"]

_LONGEST = 107
"""Longest path in bytes: sun_path has 108 bytes and ends with a zero."""


class ControlSocket:
    """A private directory for one listening socket; the socket may be made again as often as needed.

    Attributes:
        path: where clients connect.

    Raises:
        OSError: there is no temporary directory, or the path of each is too long for a socket.
    """

    def __init__(self) -> None:
        # The path of TMPDIR may be too long for a socket; those of build systems and pytest often are.
        for parent in (tempfile.gettempdir(), "/tmp"):  # noqa: S108  (mkdtemp makes a directory of mode 0700 in it)
            directory = tempfile.mkdtemp(prefix="otmcp-", dir=parent)
            self.path = os.path.join(directory, "control")
            if len(os.fsencode(self.path)) <= _LONGEST:
                self._directory = directory
                return
            os.rmdir(directory)
        raise OSError(errno.ENAMETOOLONG, "no temporary directory has a path short enough for a control socket")

    def listen(self) -> socket.socket:
        """Return a listening socket at the path; no other socket may exist there."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        directory = os.open(self._directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            # The kernel lists a socket under the name that it was bound to, and every process can read the list.
            listener.bind(f"/proc/self/fd/{directory}/{os.path.basename(self.path)}")
            listener.listen()
        except BaseException:
            listener.close()
            raise
        finally:
            os.close(directory)
        return listener

    def clear(self) -> None:
        """Remove the socket of a device that has ended: nothing listens on it, and the next device needs its name."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.path)

    def remove(self) -> None:
        """Remove the directory."""
        shutil.rmtree(self._directory, ignore_errors=True)
