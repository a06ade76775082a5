"""Checks that the running kit is the installed kit: its files, its functions in memory, the tasks.

The checks cannot prevent a determined person from manipulating a run; they make the record of such a run say so.
"""

from __future__ import annotations

import ast
import base64
import hashlib
import sys
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from importlib import metadata
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import FunctionType, ModuleType

from ..core import files
from ..suite.catalogue import SHARED_ITEMS, task_modules
from ..trial.task import Task

__all__ = ["altered_task", "changed_files", "replaced_functions"]

_KIT = Path(__file__).resolve().parents[1]
_WRAPPING = _KIT / "trial" / "check.py"
_LIBRARY = Path(hashlib.__file__).resolve().parent
_PACKAGE = __package__.partition(".")[0]
_ROOMS_WITHOUT_JUDGEMENT = tuple(
    f"{_PACKAGE}.{room}" for room in ("cli", "onboarding", "report", "conformance", "mocks", "reference_adapters")
)
"""Packages that take no part in a judgement: those that show results or help with a subject file, and those that only a wheel
has inside the kit's folder (of these, tasks are compared with their declarations, and mocks and adapters run in processes of
their own). Every other package takes part in a judgement."""


def changed_files() -> list[str]:
    """Return one sentence if files of the installed kit differ from those of its wheel; none for a source checkout."""
    try:
        distribution = metadata.distribution("pytest-otmcp")
    except metadata.PackageNotFoundError:
        return [f"the kit is not installed; it was imported from {_KIT}"]
    recorded = [file for file in distribution.files or () if file.parts[0] == _KIT.name and file.hash is not None]
    if not recorded:
        return []
    installed = Path(str(distribution.locate_file(_KIT.name))).resolve()
    if installed != _KIT:
        return [f"the kit was imported from {_KIT}, it is installed in {installed}"]
    changed = [str(file) for file in recorded if not _has_digest(Path(str(file.locate())), file.hash)]
    if not changed:
        return []
    return [f"files of the installed kit were changed: {', '.join(changed[:5])}{' …' if changed[5:] else ''}"]


def _has_digest(path: Path, recorded: metadata.FileHash | None) -> bool:
    if recorded is None:
        return True
    try:
        digest = hashlib.new(recorded.mode, files.read(path)).digest()
    except OSError:
        return False
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode() == recorded.value


def replaced_functions() -> list[str]:
    """Return one sentence for each function of the kit that was replaced (monkeypatched) by code from elsewhere."""
    return [
        f"{module.__name__}.{what} was replaced by something from {where}"
        for module in _find_judging_modules()
        for what, where in _find_replaced(module)
    ]


def _find_judging_modules() -> list[ModuleType]:
    """Return every loaded module of the kit that takes part in a judgement."""
    return [
        module
        for name, module in sorted(sys.modules.items())
        if name.startswith(f"{_PACKAGE}.")
        and not name.startswith(_ROOMS_WITHOUT_JUDGEMENT)
        and getattr(module, "__file__", None) is not None
        and Path(str(module.__file__)).is_relative_to(_KIT)
    ]


def altered_task(task: Task) -> list[str]:
    """Return one sentence for each attribute of a task of the suite that differs from the declaration in its module."""
    declared, files = _load_declared_tasks()[task.id]
    found = []
    for attribute in (field.name for field in fields(task)):
        value, genuine = getattr(task, attribute), getattr(declared, attribute)
        if callable(genuine):
            if (file := _foreign_file(value, files)) is not None:
                found.append(f"{attribute} of the task {task.id} were replaced by something from {file}")
        elif value != genuine:
            found.append(f"{attribute} of the task {task.id} was altered from {genuine!r} to {value!r}")
    return found


def _foreign_file(function: object, files: Path) -> str | None:
    """Return the file that a function comes from when that is none of ``files``; None when it is.

    pytest rewrites asserts, so the code may differ; the file that it comes from may not. Steps for every protocol are wrapped by the
    kit, once for each protocol; those of items that every further protocol has come from the kit's own suite.
    """
    file = str(getattr(getattr(function, "__code__", None), "co_filename", "elsewhere"))
    wrapped = getattr(function, "__wrapped__", None)
    path = Path(file).resolve()
    if wrapped is not None and path == _WRAPPING:
        return _foreign_file(wrapped, files)
    return None if path.is_relative_to(files) or path == _shared_items() else file


@cache
def _shared_items() -> Path:
    found = find_spec(SHARED_ITEMS)
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).resolve()


@cache
def _load_declared_tasks() -> dict[str, tuple[Task, Path]]:
    """Load all tasks a second time, into private modules that no other code can reach; return each with the folder of its
    module, by id."""
    tasks: dict[str, tuple[Task, Path]] = {}
    for name in task_modules():
        found = find_spec(name)
        assert found is not None
        assert found.origin is not None
        spec = spec_from_file_location(f"{name.rpartition('.')[0]}._declared_{name.rpartition('.')[2]}", found.origin)
        assert spec is not None
        assert spec.loader is not None
        module = module_from_spec(spec)
        # dataclasses looks a class's module up by its name while the module is executed; afterwards nobody is to find it.
        sys.modules[spec.name] = module
        try:
            spec.loader.exec_module(module)
        finally:
            del sys.modules[spec.name]
        tasks |= {task.id: (task, Path(found.origin).resolve().parent) for task in module.TASKS}
    return tasks


@cache
def _top_level_names(file: str) -> tuple[str, ...]:
    """Return the names of the functions and classes that a module defines at its top level."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body
    return tuple(node.name for node in body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef))


def _find_replaced(module: ModuleType) -> Iterator[tuple[str, str]]:
    for name in _top_level_names(str(module.__file__)):
        value = vars(module).get(name)
        if isinstance(value, type) and value.__module__ == module.__name__:
            for member, held in vars(value).items():
                function = getattr(held, "__func__", getattr(held, "fget", held))
                if isinstance(function, FunctionType) and not _is_of_kit(function):
                    yield f"{name}.{member}", function.__code__.co_filename
        elif isinstance(value, FunctionType):
            if not _is_of_kit(value):
                yield name, value.__code__.co_filename
        elif not _is_defined_in(value, module):
            yield name, repr(type(value))


def _is_of_kit(function: FunctionType) -> bool:
    return _is_trusted_file(function.__code__.co_filename)


@cache
def _is_trusted_file(file: str) -> bool:
    # Functions that dataclasses and enums generate have no file; functions that decorators add are the standard library's.
    path = Path(file).resolve()
    return file.startswith("<") or path.is_relative_to(_KIT) or path.parent == _LIBRARY


def _is_defined_in(value: object, module: ModuleType) -> bool:
    # A fixture is an object of pytest around a function of the module; any other object under the name of a function is
    # foreign.
    wrapped = getattr(value, "__wrapped__", value)
    return getattr(wrapped, "__module__", None) == module.__name__
