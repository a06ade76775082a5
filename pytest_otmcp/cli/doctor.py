"""``otmcp doctor``: the reason why an adapter does not start, or facts about an adapter that starts."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import SubjectError, UsageError
from ..core.text import counted
from ..protocols.journal import ADAPTER
from ..protocols.registry import protocols
from ..subject.claims import Claims
from . import add_json, show, show_json, tell
from .init import parse_environment, recognise_protocol
from .isolated import add_option, isolated

if TYPE_CHECKING:
    from ..session.isolation import Isolation
    from ..session.loop import LoopThread
    from ..subject.model import Adapter
    from ..trial.adapter_under_test import AdapterUnderTest

__all__ = ["add_parser", "named_or_here", "run"]

_SUBJECT = Path("otmcp.toml")
"""The subject file, where none is named."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "doctor",
        help="find out why an adapter does not start",
        description=(
            "Start the adapters of a subject file, or a COMMAND, at mock devices, and explain what goes wrong: also whether an "
            "adapter really talks to the mock device. Nothing is written."
        ),
    )
    parser.add_argument(
        "--subject",
        metavar="FILE",
        type=Path,
        help="a subject file (default: otmcp.toml, else the reference adapters of every run)",
    )
    parser.add_argument("--protocol", choices=tuple(protocols()), help="what COMMAND speaks (default: seen in it)")
    parser.add_argument("--env", metavar="NAME=VALUE", action="append", default=[], help="environment of COMMAND")
    parser.add_argument(
        "--file", metavar="NAME=CONTENT", action="append", default=[], help="a file below {work}, as for otmcp init"
    )
    parser.add_argument(
        "--secret-env", metavar="NAME", action="append", default=[], help="a variable of COMMAND that takes a secret"
    )
    parser.add_argument("--url", help="endpoint of COMMAND, when it serves streamable HTTP")
    add_option(parser)
    parser.add_argument("command", metavar="COMMAND", nargs="*", help="how an adapter is started, after --")
    add_json(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """What was found of one adapter.

    Attributes:
        well: it starts and fits its description.
        said: what was found, in sentences.
        not_bound: facets that the subject file claims by its silence, and that nothing in it exercises; None where it describes no
            operation.
        no_certificate: what keeps the file, as it stands, from a certificate.
    """

    protocol: str
    command: list[str]
    well: bool
    said: list[str]
    not_bound: list[str] | None
    no_certificate: list[str]


def run(args: argparse.Namespace) -> int:
    """Examine every adapter; return 0 when all of them start and fit their description."""
    from ..session.loop import LoopThread

    loop = LoopThread()
    try:
        with isolated(args) as isolation:
            found = [_examined(loop, adapter, isolation, quiet=args.json) for adapter in _adapters(args)]
    finally:
        loop.close()
    well = all(one.well for one in found)
    if args.json:
        show_json([asdict(one) for one in found])
    elif well and all(one.not_bound is not None for one in found):
        if any(one.not_bound for one in found):
            state = "what is bound is well; bind the rest or declare it as unclaimed, then"
        elif any(one.no_certificate for one in found):
            state = "all is well for a run, but not for a certificate, next"
        else:
            state = "all is well, next"
        show(f"{state}: {_next(args)}")
    elif well and args.command:
        show("it can be asked, next: otmcp init with the same words")
    elif well:
        show(
            "nothing is bound for some of them, so nothing can be asked: bind what otmcp init proposes, and try it with otmcp call"
        )
    return 0 if well else 1


def _examined(loop: LoopThread, adapter: Adapter, isolation: Isolation, *, quiet: bool) -> Examined:
    """Examine the launches of an adapter; say at once what is found, unless this is to be quiet."""
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if not quiet:
            tell(f"  {line}")

    command = [*adapter.variants["rw"].command]
    if not quiet:
        tell(f"{protocols()[adapter.protocol].name}: {' '.join(command)}")
    well = True
    for variant in _different(adapter):
        well &= loop.run(_examine(adapter, variant, isolation, say))
    gaps = _gaps(adapter) if adapter.operations else None
    objections: list[str] = []
    if gaps:
        say(f"not bound, and not declared as unclaimed: {', '.join(gaps)}; items that need them cannot be tested")
    if adapter.unclaimed and adapter.operations:
        say(f"unclaimed: {', '.join(adapter.unclaimed)}; items that need them do not apply")
        from ..certificate.eligibility import unguarded

        objections += unguarded(Claims.of_subject({adapter.protocol: adapter}), [adapter.protocol])
        for objection in objections:
            say(f"no certificate: {objection}")
    return Examined(
        protocol=adapter.protocol, command=command, well=well, said=said, not_bound=gaps, no_certificate=objections
    )


def _different(adapter: Adapter) -> list[str]:
    """Return the variants to examine: those that are started in the same way behave in the same way, so one of them is enough."""
    known = list(adapter.variants.items())
    return [name for index, (name, one) in enumerate(known) if one not in (other for _, other in known[:index])]


def _gaps(adapter: Adapter) -> list[str]:
    """Return the facets that the subject file claims by its silence, and that nothing in it exercises."""
    known = protocols()[adapter.protocol]
    gaps = [
        name
        for name in known.facets
        if not known.is_voluntary(name)
        # An input of an operation that is not claimed is not claimed either.
        and adapter.unclaimed.keys().isdisjoint((name, name.partition(".")[0]))
        and adapter.why_not_testable(name) is not None
    ]
    # Of an operation that is not bound no input can be.
    return [name for name in gaps if "." not in name or name.partition(".")[0] not in gaps]


def _next(args: argparse.Namespace) -> str:
    if args.subject is not None:
        return f"pytest --otmcp-subject={args.subject} --otmcp-reps=3"
    return "pytest --otmcp-reps=3" if _SUBJECT.is_file() else "otmcp init -- COMMAND, with an adapter of yours"


def _adapters(args: argparse.Namespace) -> Iterator[Adapter]:
    from ..onboarding.drafting import describe_launch
    from ..subject.selection import missing_library, select

    if args.command:
        if args.subject is not None:
            raise UsageError("give either --subject or a COMMAND")
        env = parse_environment(args.env)
        protocol = args.protocol or recognise_protocol(args.command, env)
        yield describe_launch(
            protocol,
            args.command,
            env,
            url=args.url,
            deadline_s=15.0,
            start_timeout_s=30.0,
            files=parse_environment(args.file, "--file"),
            secret_env=args.secret_env,
        )
        return
    source = named_or_here(args.subject)
    yield from select(source).subject.adapters.values()
    if source is None and not args.json:
        # Those above are the adapters that every run has. Further ones may lack their library, which is no illness.
        for protocol in protocols().values():
            if missing := missing_library(protocol):
                tell(f"{protocol.name}: {missing}")


def named_or_here(given: Path | None) -> Path | None:
    """Return the subject file that is named, or the one that is here; None, and say so, where there is neither."""
    if given is None and not _SUBJECT.is_file():
        show(f"no subject file {_SUBJECT} here: these are the reference adapters", sys.stderr)
        return None
    return given or _SUBJECT


async def _examine(adapter: Adapter, variant: str, isolation: Isolation, say: Callable[[str], None]) -> bool:
    """Start one variant and say what is found; tell whether it is well."""
    from ..onboarding.known_causes import find_advice
    from ..onboarding.pack import load_pack
    from ..plant.mock_device import MockDevice
    from ..report.causes import remedy
    from ..subject.binding_check import check_bindings
    from ..subject.model import READ_WRITE, SECURE_FORM
    from ..subject.tools import unbound
    from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
    from ..trial.proving import ARRIVAL
    from ..trial.session_proof import prove_session

    program = adapter.variants[variant].command[0]
    device = MockDevice(protocols()[adapter.protocol].mock, adapter.protocol, secure=variant == SECURE_FORM)
    device.walls = isolation.walls(outside=adapter.openings.why_outside, cable=protocols()[adapter.protocol].cable)
    under_test = None
    try:
        await device.launch()
        under_test = AdapterUnderTest(adapter, variant, device, BenchOptions())
        await under_test.open()
        session = under_test.session
        assert session is not None
        took = (session.ready_ns - session.spawned_ns) / 1e9
        say(
            f"{variant}: starts in {took:.1f} s: {' '.join(filter(None, (session.server_name, session.server_version)))}, "
            f"MCP {session.protocol_version}, {counted(len(session.tools), 'tool')}"
        )
        if under_test.legacy:
            say(
                f"{variant}: ends at the first request of today's handshake, or never answers it, so it was given that of 2025: say era = 'legacy'"
            )
        count, first = session.stray_output()
        if count:
            say(f"{variant}: {counted(count, 'line')} on stdout that no MCP message is, the first: {first[0]!r}")
        faults = check_bindings(adapter, session.tools) if variant == READ_WRITE else []
        for fault in faults:
            say(f"{variant}: {fault}")
        if faults:
            return False
        if not adapter.operations:
            # Nobody has said how it is asked, so a connection is all that can be looked for, and none may be due yet.
            connected = any(entry["origin"] == ADAPTER for entry in (await device.journal(0)).entries)
            say(f"{variant}: the device {'has seen a connection' if connected else 'has not been asked anything yet'}")
            return _keeps_secrets(under_test, variant, say)
        if variant == READ_WRITE and (unknown := unbound(adapter, session.tools)):
            say(
                f"{variant}: nothing is bound to {', '.join(unknown)}; no run judges what they answer, and a pass says nothing about it"
            )
        problem = await prove_session(under_test)
        weak = {way.operation for way in protocols()[adapter.protocol].proof.ways if way.weak} | {ARRIVAL}
        shown = (
            "the adapter has reached the mock device"
            if under_test.cursor.proven in weak
            else "a random value went between the mock device and the adapter"
        )
        say(f"{variant}: {problem or f'{shown}: it talks to the mock'}")
        return _keeps_secrets(under_test, variant, say) and problem is None
    except SubjectError as failure:
        say(f"{variant}: {failure}")
        known = protocols()[adapter.protocol].onboarding is not None
        causes = load_pack(adapter.protocol).causes if known else ()
        found = [f"{advice.cause} {advice.remedy}" for advice in find_advice(str(failure), causes)]
        for told in found or filter(None, [remedy(None, failure.code)]):
            say(f"-> {told}")
        if shutil.which(program) is not None:
            say(f"({program} is {shutil.which(program)})")
        return False
    finally:
        if under_test is not None:
            await under_test.close()
        await device.close()


def _keeps_secrets(under_test: AdapterUnderTest, variant: str, say: Callable[[str], None]) -> bool:
    """Say which secrets the adapter has told; tell whether it has told none."""
    leaks = under_test.take_leaks()
    for leak in leaks:
        say(f"{variant}: {leak.place} has the value of {leak.variable}, {leak.form}")
    return not leaks
