"""A fixture that installs an example's adapter into an environment that later runs find again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from .examples import NotInstalled, install

Install = Callable[[str], Path]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Install:
    """``installed(name)``: the example's subject file in a directory of its own with its adapter in ``.venv``.

    The test is skipped where the packages cannot be installed, or where OTMCP_NO_NETWORK forbids to install them.
    """
    # The cache lies beside pytest's own directories, which belong to this user alone; pytest removes those in time, but
    # not the cache.
    cache = tmp_path_factory.getbasetemp().parent / "adapters-in-the-wild"

    def installed(name: str) -> Path:
        try:
            return install(name, cache)
        except NotInstalled as reason:
            pytest.skip(str(reason))

    return installed
