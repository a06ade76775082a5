"""The address of a built site of the documentation, to which the links of reports lead where it is configured."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

from .errors import UsageError

__all__ = ["DOCS_URL", "site"]

DOCS_URL = "OTMCP_DOCS_URL"
"""The environment variable that names it."""


def site() -> str:
    """Return the address without a slash at its end; empty where none is configured.

    Raises:
        UsageError: the variable is not an address of http or https.
    """
    found = os.environ.get(DOCS_URL, "")
    if found and urlsplit(found).scheme not in ("http", "https"):
        raise UsageError(f"{DOCS_URL}: an address begins with https:// or http://, not {found[:40]!a}")
    return found.rstrip("/")
