"""``otmcp verify``: a check that a certificate follows from its run, and the run's judgement from its history.

The command refuses files that were edited or torn. It also refuses a valid record that another kit judged: only the kit that
judged a history can judge it again. The files may be hostile: each is read once, they are examined in a process with bounded
memory and time, and nothing of them is printed as it is.
"""

from __future__ import annotations

import argparse
import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.text import harmless
from . import Refusal, add_json, show, show_json
from .confined import CEILING_S

if TYPE_CHECKING:
    from .signature import Signer

__all__ = ["add_parser", "examination", "run"]

_SIGNATURE = ".sig"


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "verify",
        help="check a certificate against its record, and judge the record again",
        description="Judge the history of a run record again, and check that a certificate says what its record says. "
        "The exit code is that of the record's verdict; it is 1, too, when anything is refused.",
    )
    parser.add_argument(
        "certificate", metavar="CERT", type=Path, nargs="?", help="a certificate.json; none for any record"
    )
    parser.add_argument("record", metavar="RUN", type=Path, help="the run.json that it is about")
    parser.add_argument(
        "--subject", metavar="FILE", type=Path, help="the subject file that was tested; nothing of it is executed"
    )
    parser.add_argument(
        "--challenge", metavar="NONCE", help="the question that you asked: the run must have been made for it"
    )
    parser.add_argument(
        "--trust",
        metavar="FILE",
        type=Path,
        help="signers that you trust, as OpenSSH's allowed_signers: CERT.sig must be a signature of one of them",
    )
    parser.add_argument(
        "--revoked",
        metavar="FILE",
        type=Path,
        help="keys that you trust no more, beside --trust: a key revocation list of ssh-keygen, or public keys, one a line",
    )
    parser.add_argument(
        "--patience",
        metavar="SECONDS",
        type=int,
        default=CEILING_S,
        help="processor time for one of the largest records, above some 60 MB (default: %(default)s)",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine the files and print the result.

    Raises:
        UsageError: one of the files is not there, or an option does not go with them.
        Refusal: the certificate, its signature or the record does not hold.
    """
    from .confined import Bounds, confined
    from .files import LARGEST_CERTIFICATE, LARGEST_RECORD, content, size
    from .signature import signer

    if args.trust is not None and args.certificate is None:
        raise UsageError("--trust: only a certificate is signed; give CERT and RUN")
    if args.revoked is not None and args.trust is None:
        raise UsageError("--revoked: it is about the keys of --trust; give both")
    certificate = None if args.certificate is None else content(args.certificate, LARGEST_CERTIFICATE)
    bounds = Bounds.of(size(args.record, LARGEST_RECORD), args.patience)
    signed_by = None
    if args.trust is not None and certificate is not None:
        if not _beside(args.certificate).is_file():
            raise Refusal(f"refused: {args.certificate} is not signed: there is no {_beside(args.certificate)}")
        signed_by = signer(
            certificate, content(_beside(args.certificate), LARGEST_CERTIFICATE), args.trust, args.revoked
        )
    asked = examination(args.record, None if certificate is None else (args.certificate, certificate))
    asked |= {"challenge": args.challenge, "subject": None if args.subject is None else str(args.subject)}
    found = confined("examination", asked, bounds, str(args.record))
    if certificate is not None:
        found["said"].append(_about_signature(args.certificate, signed_by, args.trust))
    if args.json:
        by, as_of = (None, None) if signed_by is None else (signed_by.name, signed_by.as_of)
        told = {
            "challenge": args.challenge,
            "signed_by": by,
            "key_valid_as_of": None if as_of is None else as_of.isoformat(),
        }
        show_json({**found["run"], **told, "said": found["said"]})
    else:
        for sentence in found["said"]:
            show(harmless(sentence))
    return int(found["code"])


def examination(record: Path, certificate: tuple[Path, bytes] | None) -> dict[str, Any]:
    """Return what :mod:`pytest_otmcp.cli.examination` is asked about a record, and a certificate with its content."""
    told = None
    if certificate is not None:
        told = {"name": str(certificate[0]), "content": base64.b64encode(certificate[1]).decode()}
    return {"record": str(record), "challenge": None, "subject": None, "certificate": told}


def _about_signature(certificate: Path, signed_by: Signer | None, trust: Path | None) -> str:
    if signed_by is not None:
        trusts = "trusts"
        if signed_by.as_of is not None:
            trusts = f"trusted at {signed_by.as_of:%Y-%m-%d %H:%M} UTC, when the certificate says that it was measured, and trusts no more"
        return f"the certificate is signed by {signed_by.name}, whom {trust} {trusts}; which adapter it was is the signer's word"
    if _beside(certificate).is_file():
        return f"{_beside(certificate)} was not checked: --trust FILE says whose signature you trust"
    return "the certificate is not signed: who ran the kit, and at which adapter, it cannot prove"


def _beside(certificate: Path) -> Path:
    return certificate.with_name(certificate.name + _SIGNATURE)
