"""Find the packages of the wheel and build its JSON Schemas; everything else about the distribution is in ``pyproject.toml``.

The rooms ``conformance``, ``mocks`` and ``reference_adapters`` are packages below ``pytest_otmcp`` in the wheel and lie beside
it in a checkout, as does ``docs``, which holds no code. setuptools can find packages of one of these places only, and a list by hand would miss the next one.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from setuptools import Command, find_packages, setup
from setuptools.command.build import build

ROOT = Path(__file__).resolve().parent
ROOMS = ("conformance", "mocks", "reference_adapters")

IMAGE = re.compile(r"^!\[[^\]]*\]\((?!https?:)[^)]*\)\n\n?", re.MULTILINE)
PAGE = re.compile(r"\[([^\]]+)\]\(docs/(?:README\.md#)?([a-z-]+)\.md\)")
FILE = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)#][^)]*\)")


def schemas() -> dict[str, str]:
    """Return the text of each schema by its path in the wheel; a subject file names the first one for editors."""
    # The kit that is being built, and not one that is installed.
    sys.path.insert(0, str(ROOT))
    from pytest_otmcp.record.json_schema import json_schema
    from pytest_otmcp.subject.schema import shipped_text

    return {
        "pytest_otmcp/subject/subject.schema.json": shipped_text(),
        "pytest_otmcp/record/run.schema.json": json_schema(),
    }


class BuildSchemas(Command):
    """Write the JSON Schemas into the wheel; for an editable install, into the checkout, which ignores them."""

    def initialize_options(self) -> None:
        """Declare what ``build`` and setuptools set."""
        self.build_lib = ""
        self.editable_mode = False

    def finalize_options(self) -> None:
        """Take the directory of the wheel's files."""
        self.build_lib = self.get_finalized_command("build_py").build_lib

    def run(self) -> None:
        """Write the files."""
        for name, text in schemas().items():
            file = (ROOT if self.editable_mode else Path(self.build_lib)) / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")

    def get_outputs(self) -> list[str]:
        """Return the paths of the files in the wheel."""
        return [str(Path(self.build_lib) / name) for name in schemas()]

    def get_output_mapping(self) -> dict[str, str]:
        """Return nothing: no file of the wheel is a copy of one of the checkout."""
        return {}

    def get_source_files(self) -> list[str]:
        """Return nothing: the modules that make the schemas are in the distribution anyway."""
        return []


class Build(build):
    """The usual build, and then the schemas."""

    sub_commands = [*build.sub_commands, ("build_schemas", None)]  # noqa: RUF012


def description() -> str:
    """Return the README as it can be read outside of the repository: without links and images that lead nowhere there.

    The pages of the documentation are in the wheel: ``otmcp docs`` prints them.
    """
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return FILE.sub(r"\1", PAGE.sub(r"\1 (`otmcp docs \2`)", IMAGE.sub("", text)))


setup(
    cmdclass={"build": Build, "build_schemas": BuildSchemas},
    long_description=description(),
    long_description_content_type="text/markdown",
    packages=[
        *find_packages(include=["pytest_otmcp", "pytest_otmcp.*"]),
        *(f"pytest_otmcp.{name}" for room in ROOMS for name in find_packages(include=[room, f"{room}.*"])),
        "pytest_otmcp.docs",
    ],
)
