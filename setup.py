"""Find the packages of the wheel; everything else about the distribution is in ``pyproject.toml``.

The rooms ``conformance``, ``mocks`` and ``reference_adapters`` are packages below ``pytest_otmcp`` in the wheel and lie beside
it in a checkout, as does ``docs``, which holds no code. setuptools can find packages of one of these places only, and a list by hand would miss the next one.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

ROOMS = ("conformance", "mocks", "reference_adapters")

IMAGE = re.compile(r"^!\[[^\]]*\]\((?!https?:)[^)]*\)\n\n?", re.MULTILINE)
PAGE = re.compile(r"\[([^\]]+)\]\(docs/([a-z-]+)\.md\)")
FILE = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)#][^)]*\)")


def description() -> str:
    """Return the README as it can be read outside of the repository: without links and images that lead nowhere there.

    The pages of the documentation are in the wheel: ``otmcp docs`` prints them.
    """
    text = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    return FILE.sub(r"\1", PAGE.sub(r"\1 (`otmcp docs \2`)", IMAGE.sub("", text)))


setup(
    long_description=description(),
    long_description_content_type="text/markdown",
    packages=[
        *find_packages(include=["pytest_otmcp", "pytest_otmcp.*"]),
        *(f"pytest_otmcp.{name}" for room in ROOMS for name in find_packages(include=[room, f"{room}.*"])),
        "pytest_otmcp.docs",
    ],
)
