"""The draft of a subject file: an adapter is started at a mock device, its tools are read and tried."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path

from ..core.errors import SubjectError, UsageError
from ..core.text import counted
from ..plant.mock_device import MockDevice
from ..protocols.envelope import check_result
from ..protocols.journal import ADAPTER, Entries
from ..protocols.registry import protocols
from ..subject.grammar import LONGEST_RECOVERY_S
from ..subject.model import READ_WRITE, Adapter, Answering, Connect, Variant
from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
from .after_outage import look_after_outage
from .commands import look_for_commands
from .document import Draft
from .experimenter import Experimenter
from .guess import Guess
from .matching import guess_steps, guess_tools, registered, status_tools
from .pack import Pack
from .product_version import product_version
from .proposal import Proposal, by_name
from .readiness import look_for_readiness
from .readings import as_proposals, look_for_readings
from .status import look_at_silence, look_without_device
from .switches import Switch, launched, look_for_switch, switches_of

__all__ = ["describe_launch", "draft"]


def describe_launch(
    protocol: str,
    command: Sequence[str],
    env: Mapping[str, str],
    *,
    url: str | None,
    deadline_s: float,
    start_timeout_s: float,
    connect: Connect | None = None,
    files: Mapping[str, str] | None = None,
    era: str | None = None,
    secret_env: Sequence[str] = (),
) -> Adapter:
    """Describe an adapter whose launch is all that is known.

    Raises:
        UsageError: a variable that takes a secret has a value in ``env``.
    """
    if given := sorted({*secret_env} & env.keys()):
        raise UsageError(f"--secret-env {given[0]}: --env gives it a value; a random one is given to it instead")
    variant = Variant(command=tuple(command), env=dict(env), cwd=None, files=dict(files or {}))
    return Adapter(
        protocol=protocol,
        directory=Path.cwd(),
        variants={"rw": variant, "ro": variant},
        operations={},
        answering=Answering(),
        unclaimed={},
        connect=connect,
        recovery="same_session",
        recovery_s=LONGEST_RECOVERY_S,
        call_limit=None,
        lists={},
        probes={},
        secrets=(),
        secret_env=tuple(secret_env),
        transport="stdio" if url is None else "http",
        url=url,
        era=era,
        deadline_s=deadline_s,
        start_timeout_s=start_timeout_s,
    )


async def draft(adapter: Adapter, pack: Pack, device: MockDevice, say: Callable[[str], None]) -> Draft:
    """Try every operation of the adapter's protocol.

    Args:
        adapter: as :func:`describe_launch` makes it.
        pack: that of its protocol.
        device: a running mock of its protocol.
        say: called with each line about the progress.

    Raises:
        SubjectError: the adapter cannot be started.
    """
    under_test = AdapterUnderTest(adapter, READ_WRITE, device, BenchOptions())
    try:
        await under_test.open()
        assert under_test.session is not None
        tools = dict(under_test.session.tools)
        name, version = under_test.session.server_name, under_test.session.server_version
        started_s = (under_test.session.ready_ns - under_test.session.spawned_ns) / 1e9
        called = " ".join(filter(None, (name or "the adapter", version)))
        say(f"{called}: {counted(len(tools), 'tool')}: {', '.join(tools)}")
        adapter = replace(adapter, era="legacy" if under_test.legacy else adapter.era)
        step, left = None, list[str]()
        if steps := guess_steps(pack, tools):
            await under_test.close()
            step, left = await _connected(adapter, steps, device, say)
            connect = None if step is None else Connect(tool=step.tool, arguments=step.arguments, again=False)
            adapter = replace(adapter, connect=connect)
            under_test = AdapterUnderTest(adapter, READ_WRITE, device, BenchOptions())
        readiness = await look_for_readiness(under_test, status_tools(pack, tools))
        if readiness is not None:
            say(f"  ready           {readiness.table['tool']} (it said {readiness.before[:60]!r} at first)")
            await under_test.close()
            adapter = replace(adapter, ready=readiness.ready)
            under_test = AdapterUnderTest(adapter, READ_WRITE, device, BenchOptions())
        experimenter = Experimenter(under_test, device, pack.late, pack.samples)
        try:
            switches = switches_of(adapter, (str(tool.get("description") or "") for tool in tools.values()))
            names = registered(step)
            proposals = await _try_operations(experimenter, pack, tools, names, say, writes=False)
            operations = protocols()[pack.protocol].operations
            # What tells a status may tell values as well.
            telling = {name: one for name, one in proposals.items() if not operations[name].status}
            readings = await look_for_readings(experimenter, pack, tools, _taken(telling, step), say)
            named = {one.tool for one in readings.values()}
            proposals = {name: one for name, one in proposals.items() if one.proven or one.guess.tool not in named}
            await _begin_writing(experimenter, proposals.values(), left)
            enabling, tools, written = await _try_writing(experimenter, adapter, switches, pack, tools, names, say)
            proposals |= written
            commands = await look_for_commands(experimenter, pack, tools, _taken(proposals, step), names, say)
            proposals = {name: one for name, one in proposals.items() if one.proven or one.guess.tool not in commands}
            switch = await look_for_switch(experimenter, adapter, (*enabling, *switches), proposals, commands)
            if switch is not None:
                say(f"  guard           {switch.name} (proven: it disables writes, and enables them)")
            named_reads = as_proposals(readings)
            await look_without_device(experimenter, named_reads | proposals)
            await look_at_silence(experimenter, named_reads | proposals)
            recovery = await look_after_outage(experimenter, named_reads | proposals)
            if recovery not in (None, "same_session"):
                say(f"  recovery        {recovery} (after the device was away nothing else helped)")
            for operation, known in protocols()[pack.protocol].operations.items():
                if known.status:
                    say(_line(operation, proposals.get(operation), {*known.needed}))
        finally:
            await experimenter.adapter.close()
    finally:
        await under_test.close()
    goods = [proposal.good for proposal in proposals.values() if proposal.proven and proposal.good is not None]
    goods += [reading.good for reading in readings.values()] + [command.good for command in commands.values()]
    results = [result for good in goods if isinstance(result := good.get("result"), dict)]
    native = bool(results) and not any(check_result(result) for result in results)
    return Draft(
        protocol=adapter.protocol,
        name=name or Path(adapter.variants["rw"].command[0]).name,
        server_version=version,
        product_version=product_version(adapter.variants["rw"].command, Path.cwd()),
        command=adapter.variants["rw"].command,
        env=adapter.variants["rw"].env,
        files=adapter.variants["rw"].files,
        secret_env=adapter.secret_env,
        era=adapter.era,
        transport_url=adapter.url,
        native=native,
        proposals=proposals,
        commands=commands,
        readings=readings,
        named_reads=[*named_reads.values()],
        connect=None if step is None else (step.tool, step.arguments),
        readiness=readiness,
        recovery=recovery,
        tools=tuple(tools),
        switch=switch,
        switches=switches,
        started_s=started_s,
        longest_s=experimenter.longest_s,
        errors=pack.errors,
        choices=pack.choices(proposals),
        left=[*_nothing_valid(experimenter), *left],
    )


def _taken(proposals: Mapping[str, Proposal], step: Guess | None) -> set[str]:
    """Return the tools that operations, or the connect step, need."""
    performed = {proposal.guess.tool for proposal in proposals.values() if proposal.proven or not proposal.tried}
    return performed | ({step.tool} if step is not None else set())


def _nothing_valid(experimenter: Experimenter) -> list[str]:
    fault = experimenter.never_valid
    if fault is None:
        return []
    return [f"no answer of this server to a tool call is valid MCP ({fault}): nothing can be proven until it is mended"]


async def _connected(
    adapter: Adapter, steps: Iterable[Guess], device: MockDevice, say: Callable[[str], None]
) -> tuple[Guess | None, list[str]]:
    """Return the first step that leads to the device, else the first that does not fail; and what is to be said of those that did."""
    accepted: Guess | None = None
    failed: list[str] = []
    for step in steps:
        if step.missing:
            failed.append(f"connect: {step.tool!r} was not called: no idea what to give for {', '.join(step.missing)}")
            continue
        for variation in step.variations():
            connect = Connect(tool=variation.tool, arguments=variation.arguments, again=False)
            under_test = AdapterUnderTest(replace(adapter, connect=connect), READ_WRITE, device, BenchOptions())
            since = await device.mark()
            try:
                await under_test.open()
            except SubjectError as failure:
                if failure.code != "connect_step":
                    raise
                failed.append(f"connect: with {json.dumps(dict(variation.arguments))} {failure}")
                continue
            finally:
                await under_test.close()
            if any(entry["origin"] == ADAPTER for entry in (await device.journal(since)).entries):
                say(f"  connect         {variation.tool} (the device was reached)")
                return variation, []
            accepted = accepted or variation
    for line in failed if accepted is None else ():
        say(f"  {line}")
    return accepted, failed if accepted is None else []


async def _try_operations(
    experimenter: Experimenter,
    pack: Pack,
    tools: Mapping[str, Mapping[str, object]],
    names: Mapping[str, str],
    say: Callable[[str], None],
    *,
    writes: bool,
) -> dict[str, Proposal]:
    """Try every operation that reads, or every one that writes.

    What was read has to prove where the adapter leads before anything is written.
    """
    proposals: dict[str, Proposal] = {}
    for operation, known in protocols()[pack.protocol].operations.items():
        if known.writes != writes:
            continue
        guesses, experiment = guess_tools(pack, operation, tools, names), pack.operations[operation].experiment
        if experiment is not None:
            proposal = await experimenter.best(guesses, experiment, writes=writes)
        else:
            proposal = by_name(guesses)
        if proposal is not None and known.voluntary and proposal.tried and not proposal.proven:
            # A tool that was proven to do something else was a candidate, and no more.
            taken = {one.guess.tool for one in proposals.values() if one.proven}
            proposal = None if proposal.guess.tool in taken else proposal
        if proposal is not None:
            proposals[operation] = proposal
        if not known.status and (proposal is not None or not known.voluntary):
            say(_line(operation, proposal, {*known.needed}))
    return proposals


async def _try_writing(
    experimenter: Experimenter,
    adapter: Adapter,
    switches: Sequence[Switch],
    pack: Pack,
    tools: dict[str, dict[str, object]],
    names: Mapping[str, str],
    say: Callable[[str], None],
) -> tuple[Sequence[Switch], dict[str, dict[str, object]], dict[str, Proposal]]:
    """Try every operation that writes; where none did, start the adapter with writes enabled by what is called so, and try again.

    Returns:
        The switch that helped, none where none was needed or none did; the tools of the launch that is in use then, and the proposals.
    """
    lines: list[str] = []
    written = await _try_operations(experimenter, pack, tools, names, lines.append, writes=True)
    enabling: Sequence[Switch] = ()
    usual = experimenter.adapter
    for switch in switches if not any(one.proven for one in written.values()) else ():
        await experimenter.adapter.close()
        experimenter.adapter = AdapterUnderTest(launched(adapter, switch.rw), READ_WRITE, usual.device, BenchOptions())
        again: list[str] = []
        try:
            await experimenter.adapter.open()
            assert experimenter.adapter.session is not None
            listed = dict(experimenter.adapter.session.tools)
            found = await _try_operations(experimenter, pack, listed, names, again.append, writes=True)
        except SubjectError:
            # It does not start so.
            continue
        if any(one.proven for one in found.values()):
            lines, tools, written, enabling = again, listed, found, (switch,)
            break
    else:
        if experimenter.adapter is not usual:
            await experimenter.adapter.close()
            experimenter.adapter = usual
    for line in lines:
        say(line)
    return enabling, tools, written


async def _begin_writing(experimenter: Experimenter, read: Iterable[Proposal], failed: Sequence[str]) -> None:
    """Give what writes a process of its own, to which nothing was said but what was proven.

    Args:
        failed: what is to be said of steps that failed, each of which may be the reason why nothing reaches the device.

    Raises:
        SubjectError: the adapter talks to another device, or to none.
    """
    adapter, device = experimenter.adapter, experimenter.device
    _refuse_unreached(adapter.endpoint, read, (await device.journal(0)).entries, failed)
    await adapter.close()
    experimenter.adapter = AdapterUnderTest(adapter.adapter, READ_WRITE, device, BenchOptions())


def _refuse_unreached(
    endpoint: Mapping[str, object], tried: Iterable[Proposal], entries: Entries, failed: Sequence[str]
) -> None:
    """Stop before anything is written when tools answered and the mock device saw nothing at all.

    Raises:
        SubjectError: the adapter talks to another device, or to none.
    """
    answered = next((proposal for proposal in tried if proposal.good is not None), None)
    if answered is None or any(entry["origin"] == "client" for entry in entries):
        return
    if failed:
        raise SubjectError(
            "connect_step", f"nothing reached the mock device, and nothing was written; {'; '.join(failed)}"
        )
    place = "host" if "host" in endpoint else "serial"
    raise SubjectError(
        "not_proven",
        f"the adapter does not talk to the mock device at {endpoint['url']}, which saw nothing: {answered.guess.tool}: "
        f"{answered.evidence[0]}. Nothing was written. Tell the adapter where the device is, with --env NAME={{{place}}}, --file or in COMMAND; if it was told, its "
        "answer may say that it is still connecting, or which value it needs that nobody can guess: then write the subject file by hand",
    )


def _line(operation: str, proposal: Proposal | None, needed: Set[str]) -> str:
    if proposal is None:
        return f"  {operation:<15} no tool found"
    mark, evidence = "not proven" if proposal.tried else "likely", proposal.evidence[0]
    if proposal.proven and needed <= proposal.outputs.keys():
        mark = "proven"
        evidence += "; not everything, see the file" if proposal.caveats else ""
    elif proposal.proven:
        mark, evidence = "asked, but not read", "; ".join([evidence, *proposal.placed])
    return f"  {operation:<15} {proposal.guess.tool} ({mark}: {evidence})"
