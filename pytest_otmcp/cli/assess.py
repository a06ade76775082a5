"""``otmcp assess``: puts tasks in words to an assistant, and judges by what the devices saw."""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..core.errors import UsageError
from . import seconds, show
from .certify import interruptible
from .doctor import named_or_here
from .isolated import add_option, isolated

if TYPE_CHECKING:
    from ..assess.campaign import Assistant
    from ..assess.results import Assessment
    from ..subject import Subject

__all__ = ["add_parser", "run"]

_FOLDER = Path("reports", "assessment")


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "assess",
        help="measure an assistant with an adapter: tasks in words, judged by the device",
        description=(
            "Put tasks in words to an assistant that gets the tools of the adapters, each at a mock device, and judge each try by what the device "
            "saw. The assistant is a command, which reads the task on standard input and finds an mcp.json at OTMCP_MCP_CONFIG; or, with --model, "
            "one of the models of Inspect. It says nothing about the adapter's conformance."
        ),
        usage="otmcp assess [options] (-- COMMAND … | --model NAME | --compare A.json B.json)",
    )
    parser.add_argument(
        "command", metavar="COMMAND", nargs="*", help="the assistant: any program that reads a task and speaks MCP"
    )
    parser.add_argument("--subject", metavar="FILE", type=Path, help="a subject file (default: otmcp.toml)")
    parser.add_argument(
        "--task", metavar="ID|FAMILY", action="append", default=[], help="only these tasks; may have * and be repeated"
    )
    parser.add_argument("--tries", metavar="K", type=_count, default=5, help="tries of each task (default: 5)")
    parser.add_argument("--seed", metavar="N", type=int, help="for the values of the tries (default: a new one)")
    parser.add_argument("--name", help="of the assistant, for reports (default: its command, or the model)")
    parser.add_argument(
        "--pass-env",
        metavar="NAME",
        action="append",
        default=[],
        help="a variable that the command gets, such as a key",
    )
    parser.add_argument(
        "--deadline", metavar="SECONDS", type=seconds, default=120.0, help="for each try (default: 120)"
    )
    parser.add_argument("--model", metavar="NAME", help="a model as Inspect names it; needs pytest-otmcp[assess]")
    parser.add_argument("--model-base-url", metavar="URL", help="its endpoint, such as http://127.0.0.1:8080/v1")
    parser.add_argument(
        "--out", metavar="DIRECTORY", type=Path, default=_FOLDER, help=f"for the files (default: {_FOLDER})"
    )
    parser.add_argument("--compare", metavar="FILE", type=Path, nargs=2, help="compare two assessments try by try")
    add_option(parser)
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"expected a number from 1 to 1000, found {text!r}")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Assess, or compare; return 0 when that was done, whatever the assistant is worth.

    Raises:
        UsageError: an option lacks another, a file is wrong, or the assistant cannot be started.
    """
    from ..assess import report, results

    ways = [bool(args.command), args.model is not None, args.compare is not None]
    if sum(ways) != 1:
        raise UsageError("expected either -- COMMAND, or --model, or --compare")
    if args.compare is not None:
        show(report.compared(*results.read(args.compare)))
        return 0
    assessment = _assessed(args)
    written = report.write(args.out, assessment)
    show(report.summary(assessment))
    show(f"written: {', '.join(str(path) for path in written)}", sys.stderr)
    return 0


def _assessed(args: argparse.Namespace) -> Assessment:
    import secrets

    from ..assess import campaign, results
    from ..subject.selection import select

    wanted = campaign.chosen(args.task)
    subject = select(named_or_here(args.subject)).subject
    seed = secrets.randbelow(1 << 32) if args.seed is None else args.seed
    began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    assessment: Assessment = {
        "form": results.FORM,
        "kit": __version__,
        "began": began,
        "assistant": args.name or args.model or " ".join(args.command),
        "engine": "inspect" if args.model else "command",
        "subject": {"name": subject.name, "version": subject.version, "digest": subject.digest},
        "seed": seed,
        "prompts": campaign.prompts_digest(),
        "tools": {},
        "tries": [],
        "not_asked": {},
    }
    try:
        with interruptible(), isolated(args) as isolation:
            if args.model is not None:
                _ask_model(assessment, subject, isolation, wanted, args)
            else:
                _fill(assessment, subject, isolation, wanted, args)
    finally:
        # Tries cost time and tokens: those that there are stay, also when the rest is interrupted.
        if assessment["tries"]:
            results.write(args.out / "assessment.json", assessment)
    return assessment


def _fill(assessment: Assessment, subject: Subject, isolation: Any, wanted: Any, args: argparse.Namespace) -> None:
    from ..assess.agent import Command
    from ..assess.campaign import run_try, tries
    from ..assess.place import Place
    from ..session.loop import LoopThread

    assistant: Assistant = Command(args.command, args.pass_env, args.deadline)

    async def go() -> None:
        place = Place(subject, isolation)
        try:
            planned, assessment["not_asked"] = tries(place, wanted, args.tries, assessment["seed"])
            if not planned:
                raise UsageError(f"the subject can have none of these tasks: {_reasons(assessment['not_asked'])}")
            for number, (assignment, count, case) in enumerate(planned, 1):
                told = await run_try(place, assignment, count, case, assistant, assessment["tools"])
                assessment["tries"].append(told)
                show(
                    f"{number}/{len(planned)} {assignment.id}: {told['verdict']}, honesty: {told['honesty']}",
                    sys.stderr,
                )
        finally:
            await place.close()

    loop = LoopThread()
    try:
        loop.run(go())
    finally:
        loop.close()


def _ask_model(assessment: Assessment, subject: Subject, isolation: Any, wanted: Any, args: argparse.Namespace) -> None:
    try:
        from ..assess import engine
    except ModuleNotFoundError as error:
        raise UsageError(f"--model needs {error.name}: install pytest-otmcp[assess]") from None
    try:
        engine.fill(
            assessment,
            subject,
            isolation,
            wanted,
            tries=args.tries,
            model=args.model,
            base_url=args.model_base_url,
            log_dir=args.out / "inspect",
            deadline_s=args.deadline,
        )
    except RuntimeError as error:
        raise UsageError(f"Inspect gave up: {error}") from None


def _reasons(not_asked: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {why}" for name, why in not_asked.items())
