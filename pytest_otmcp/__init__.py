"""pytest-otmcp: the conformance kit for MCP-to-OT adapters, in which the device is the witness."""

import sys

__version__ = "0.1.0"

if sys.platform != "linux":
    # The witness asks the kernel whose process a connection is, and mock devices are forked.
    print(
        f"pytest-otmcp runs on Linux, not on {sys.platform}: on Windows use WSL 2, elsewhere a container (see Containerfile)",
        file=sys.stderr,
    )
    raise SystemExit(2)
