"""``otmcp init``: a first subject file, proposed from the adapter's own tools and tried at a mock device."""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import SubjectError, UsageError
from ..core.files import read
from ..core.library_registry import libraries
from ..protocols.registry import protocols
from ..subject.imports import libraries_used
from . import Refusal, seconds, show, tell
from .isolated import add_option, isolated

if TYPE_CHECKING:
    from ..session.isolation import Isolation

__all__ = ["add_parser", "parse_environment", "recognise_protocol", "run"]


_DEFAULT = Path("otmcp.toml")
"""The file that is written, where none is named: pytest takes it without being told."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "init",
        help="propose a subject file for an adapter",
        description=(
            "Start the adapter at a mock device, read its tools, try them, and write a commented otmcp.toml. In COMMAND and "
            "in --env {host}, {port}, {url} and, for a serial line, {serial} stand for the mock device. Tools that write are tried only after random values of "
            "the mock device came back through the adapter, or, where no tool reads, a client arrived at the mock broker. Among them are tools that no "
            "operation needs and whose names say that they command the plant. Tools that read are called wherever the adapter leads, and none of "
            "them whose name says that it changes something. Variables and options that the tools or the adapter's own files name, and that may disable "
            "its writes, are tried one by one."
        ),
    )
    parser.add_argument(
        "--protocol",
        choices=tuple(protocols()),
        help="what the adapter speaks (default: seen in COMMAND, in --env, or in what the adapter imports)",
    )
    parser.add_argument(
        "--env", metavar="NAME=VALUE", action="append", default=[], help="environment of the adapter; may be repeated"
    )
    parser.add_argument(
        "--file",
        metavar="NAME=CONTENT",
        action="append",
        default=[],
        help="a file below {work}, written before the launch; {host} and its like stand for the mock device",
    )
    parser.add_argument(
        "--secret-env",
        metavar="NAME",
        action="append",
        default=[],
        help="a variable that takes a secret: the adapter gets a random value in it, and must not tell it; may be repeated",
    )
    parser.add_argument(
        "--era",
        choices=("auto", "legacy"),
        help="'legacy' for a server that must be addressed by the handshake of 2025-11-25 (default: found out)",
    )
    parser.add_argument("--url", help="its endpoint, when it serves streamable HTTP: http://127.0.0.1:{http_port}/mcp")
    add_option(parser)
    parser.add_argument(
        "--deadline", metavar="S", type=seconds, default=15.0, help="seconds for each call (default: 15)"
    )
    parser.add_argument("--out", metavar="FILE", type=Path, default=_DEFAULT, help="default: otmcp.toml")
    parser.add_argument("--force", action="store_true", help="replace FILE when it exists")
    parser.add_argument("command", metavar="COMMAND", nargs="+", help="how the adapter is started, after --")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the proposal and print what is left to fill in.

    Raises:
        UsageError: an option is wrong, or the protocol cannot be recognised.
        Refusal: the adapter cannot be started.
    """
    env, files = parse_environment(args.env), parse_environment(args.file, "--file")
    protocol = args.protocol or recognise_protocol(args.command, env)
    added_to = None if args.force else _existing(args.out, protocol)
    if not 0 < args.deadline <= 300:
        raise UsageError(f"--deadline: expected seconds above 0 and up to 300, found {args.deadline:g}")

    from ..onboarding.document import Draft, write_document
    from ..onboarding.drafting import describe_launch, draft
    from ..onboarding.known_causes import find_advice, find_library_advice
    from ..onboarding.pack import load_pack
    from ..plant.mock_device import MockDevice
    from ..session.loop import LoopThread
    from ..subject import load_subject

    pack = load_pack(protocol)
    adapter = describe_launch(
        protocol,
        args.command,
        env,
        url=args.url,
        deadline_s=args.deadline,
        start_timeout_s=max(30.0, args.deadline),
        files=files,
        era=args.era,
        secret_env=args.secret_env,
    )

    async def work(isolation: Isolation) -> Draft:
        device = MockDevice(protocols()[protocol].mock, protocol)
        device.walls = isolation.walls(cable=protocols()[protocol].cable)
        try:
            await device.launch()
            return await draft(adapter, pack, device, tell)
        finally:
            await device.close()

    tell(f"{protocols()[protocol].name}: {' '.join(args.command)}")
    loop = LoopThread()
    try:
        with isolated(args) as isolation:
            drafted = loop.run(work(isolation))
    except SubjectError as failure:
        # One that started and reached nothing has other causes than one that did not start.
        started = failure.code in ("not_proven", "connect_step")
        found = find_library_advice(str(failure), pack.causes) if started else find_advice(str(failure), pack.causes)
        for advice in found:
            tell(f"  -> {advice.cause} {advice.remedy}")
        raise Refusal(f"no proposal: {failure}", quotes=True) from None
    finally:
        loop.close()
    drafted = replace(drafted, command=[_from_file(part, args.out.parent) for part in drafted.command])
    text = write_document(drafted, into=added_to is not None)
    before = f"#:schema {_schema(args.out.parent)}\n" if added_to is None else f"{added_to.rstrip()}\n\n"
    args.out.write_text(before + text, encoding="utf-8")
    # A proposal that cannot be loaded is a fault of the kit; it is better found here than by the user.
    bound = load_subject(args.out).adapters[protocol].operations
    show(f"\n{args.out} is written. What is left to fill in:")
    for line in drafted.left:
        tell(f"  - {line}")
    named = "" if args.out == _DEFAULT else f"--otmcp-subject={args.out} "
    if not bound:
        show("No operation is bound, so a run has little to ask: bind one, and try it with otmcp call.")
    show(f"Then: pytest {named}--otmcp-reps=3")
    return 0


def _existing(path: Path, protocol: str) -> str | None:
    """Return the text of a subject file that has no adapter for the protocol yet; None when there is no file.

    Raises:
        UsageError: the file must not be changed.
    """
    if not path.exists():
        return None
    text = read(path).decode("utf-8")
    try:
        adapters = tomllib.loads(text)["adapter"]
        there = protocol in adapters
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        there = True
    if there:
        raise UsageError(f"{path}: exists already; give another --out, or --force to replace it")
    return text


def _schema(directory: Path) -> str:
    """Return where editors find the schema of the subject file: from its directory, if it lies below that, as in a ``.venv``."""
    from ..subject.schema import SHIPPED

    below = SHIPPED.is_relative_to(directory.absolute())
    return os.path.relpath(SHIPPED, directory) if below else str(SHIPPED)


def _from_file(part: str, directory: Path) -> str:
    """Return a word of the command; a file is named from the directory of the subject file, which may be used from anywhere."""
    path = Path(part)
    if path.is_absolute() or not path.is_file() or "{" in part:
        return part
    return f"{{dir}}/{os.path.relpath(path, directory)}"


def parse_environment(options: Sequence[str], flag: str = "--env") -> Mapping[str, str]:
    """Return the options ``--env NAME=VALUE`` as a table.

    Raises:
        UsageError: an option has another form.
    """
    table = {}
    for option in options:
        name, found, value = option.partition("=")
        if not found or not name:
            raise UsageError(f"{flag}: expected NAME=VALUE, found {option!r}")
        table[name] = value
    return table


def recognise_protocol(command: Sequence[str], env: Mapping[str, str]) -> str:
    """Return the one protocol that the command and its variables name, or else the one whose library the adapter's files import.

    Raises:
        UsageError: there is none, or more than one.
    """
    text = " ".join([*command, *env, *env.values()])
    named = [key for key, protocol in protocols().items() if protocol.recognise.search(text)]
    if not named:
        used = libraries_used(command, None)
        named = [
            key for key, protocol in protocols().items() if not used.keys().isdisjoint(libraries(protocol.package))
        ]
    match named:
        case [protocol]:
            return protocol
        case []:
            what = "the command names no protocol, and no known library of one is imported"
        case _:
            what = f"{' and '.join(named)}: the command or the imports of the adapter name each"
    raise UsageError(f"{what}; add --protocol with one of: {', '.join(protocols())}")
