"""Find the packages of the wheel; everything else about the distribution is in ``pyproject.toml``.

The rooms ``conformance``, ``mocks`` and ``reference_adapters`` are packages below ``pytest_otmcp`` in the wheel and lie beside
it in a checkout. setuptools can find packages of one of these places only, and a list by hand would miss the next one.
"""

from setuptools import find_packages, setup

ROOMS = ("conformance", "mocks", "reference_adapters")

setup(
    packages=[
        *find_packages(include=["pytest_otmcp", "pytest_otmcp.*"]),
        *(f"pytest_otmcp.{name}" for room in ROOMS for name in find_packages(include=[room, f"{room}.*"])),
    ]
)
