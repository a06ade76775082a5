"""Detached signatures of certificates, by OpenSSH's own program: a vendor signs with the key that it has already.

The signature is an SSH signature (PROTOCOL.sshsig of OpenSSH) in the namespace ``otmcp-certificate``. Anybody can check it without
the kit: ``ssh-keygen -Y verify -f allowed_signers -I WHO -n otmcp-certificate -s certificate.json.sig < certificate.json``.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ..core.errors import UsageError
from ..core.files import read
from ..core.strict_json import parse_strict
from . import Refusal

__all__ = ["NAMESPACE", "Signer", "check_key", "sign", "signer"]

NAMESPACE = "otmcp-certificate"
"""What a signature is for: a key's signature over a git commit is none over a certificate."""

_PROGRAM = "ssh-keygen"
_PATIENCE_S = 60.0
_PATIENCE_WITH_PERSON_S = 600.0
"""A passphrase, or the touch of a security key, is somebody's to give."""


def check_key(key: Path) -> None:
    """Check that a key can be asked for, before a run of a minute is made for it.

    Raises:
        UsageError: there is no OpenSSH here, or no such key.
    """
    if not key.is_file():
        raise UsageError(f"--sign: {key}: there is no such key file")
    done = _ssh_keygen("-l", "-f", str(key))
    if done.returncode != 0:
        raise UsageError(f"--sign: {key} is no SSH key: {_words(done)}")


def sign(path: Path, key: Path) -> Path:
    """Sign a file; return the path of the signature beside it.

    Args:
        path: the file.
        key: of OpenSSH: a private key, or a public key whose private one the agent has.

    Raises:
        Refusal: the key does not sign.
    """
    signature = path.with_name(path.name + ".sig")
    # During the run an adapter may have put a link there.
    signature.unlink(missing_ok=True)
    done = _ssh_keygen("-Y", "sign", "-f", str(key), "-n", NAMESPACE, str(path), patience_s=_PATIENCE_WITH_PERSON_S)
    if done.returncode != 0:
        raise Refusal(f"{path} is valid, but not signed: {_words(done)}")
    return signature


@dataclass(frozen=True, slots=True)
class Signer:
    """Who has signed a certificate.

    Attributes:
        name: as the file of trusted signers has it.
        as_of: when the certificate says that it was measured, where its key is trusted as of then and not as of today; else None.
    """

    name: str
    as_of: datetime | None = None


def signer(content: bytes, signature: bytes, trust: Path, revoked: Path | None = None) -> Signer:
    """Return who has signed.

    A key that has expired takes none of its certificates along: as git does with a commit, the key is judged as of the time that stands
    in what was signed, if it is not valid today. Who has stolen such a key can back-date: ``revoked`` is judged as of today.

    Args:
        content: that was signed.
        signature: an SSH signature.
        trust: a file as ``allowed_signers`` of ssh-keygen(1).
        revoked: keys that are trusted no more: a key revocation list of ssh-keygen(1), or public keys, one a line.

    Raises:
        UsageError: there is no OpenSSH here, or no such file.
        Refusal: the signature is of another content, or of nobody who is trusted today or was at that time.
    """
    if not trust.is_file():
        raise UsageError(f"--trust: {trust}: there is no such file")
    if revoked is not None and not revoked.is_file():
        raise UsageError(f"--revoked: {revoked}: there is no such file")
    with tempfile.TemporaryDirectory(prefix="otmcp-") as directory:
        file = Path(directory, "signature")
        file.write_bytes(signature)
        lines = list(_one_by_one(trust, Path(directory)))
        refusal = ""
        for as_of in _times(content):
            for signers in lines:
                name, why_not = _who(file, signers, as_of, content, revoked)
                if not why_not:
                    return Signer(name, as_of)
                refusal = refusal or (
                    f"the signature of {name} does not hold for this certificate: {why_not}"
                    if name
                    else f"the signature of the certificate is of nobody whom {trust} trusts: {why_not}"
                )
    raise Refusal(f"refused: {refusal}")


def _who(
    signature: Path, signers: Path, as_of: datetime | None, content: bytes, revoked: Path | None
) -> tuple[str, str]:
    """Return whose key has signed, or nothing, and why the signature does not hold, or nothing.

    Args:
        as_of: the time as of which the key is to be valid; None is today.
    """
    # Without a zone it is local time, as the times of the file are; before OpenSSH 9.1 there is no other.
    when = [] if as_of is None else [f"-Overify-time={as_of.astimezone():%Y%m%d%H%M%S}"]
    found = _ssh_keygen("-Y", "find-principals", *when, "-s", str(signature), "-f", str(signers))
    # One line of the file may name several principals: each comes on a line of its own, patterns that are excluded among them.
    names = [line for line in found.stdout.decode("utf-8", "replace").split("\n") if line and not line.startswith("!")]
    if found.returncode != 0 or not names:
        return "", _words(found)
    asked = ["-Y", "verify", *when, "-f", str(signers), "-I", names[0], "-n", NAMESPACE, "-s", str(signature)]
    if revoked is not None:
        asked += ["-r", str(revoked)]
    done = _ssh_keygen(*asked, given=content)
    return ",".join(names), "" if done.returncode == 0 else _words(done)


def _times(content: bytes) -> Iterator[datetime | None]:
    """Yield today, and then the time at which a certificate says that its run began, if that is not in the future."""
    yield None
    with suppress(ValueError, KeyError, TypeError):
        stated = datetime.fromisoformat(parse_strict(content)["predicate"]["otmcp"]["measured_at"])
        if stated < datetime.now(UTC):
            yield stated


def _one_by_one(trust: Path, directory: Path) -> Iterator[Path]:
    """Return the file of trusted signers, and then files with one of its lines each.

    A key may stand in several lines, as of a person for commits and as of a product for certificates. Asked whose it is, ssh-keygen
    names the first of them, and the signature is judged by that line alone.
    """
    yield trust
    lines = [line for line in read(trust).splitlines() if line.strip() and not line.lstrip().startswith(b"#")]
    for number, line in enumerate(lines if len(lines) > 1 else []):
        alone = directory / f"signers-{number}"
        alone.write_bytes(line + b"\n")
        yield alone


def _ssh_keygen(
    *arguments: str, given: bytes | None = None, patience_s: float = _PATIENCE_S
) -> subprocess.CompletedProcess[bytes]:
    try:
        # Without input, a question about a file that is there already is answered with the end of it.
        return subprocess.run(
            [_PROGRAM, *arguments],
            input=given or b"",
            capture_output=True,
            timeout=patience_s,
            check=False,
        )
    except FileNotFoundError:
        raise UsageError(f"signatures need {_PROGRAM} of OpenSSH 8.2 or later, which is not on PATH") from None
    except subprocess.TimeoutExpired:
        raise UsageError(f"{_PROGRAM} {arguments[1]} has not ended after {patience_s:g} s") from None


def _words(done: subprocess.CompletedProcess[bytes]) -> str:
    lines = (done.stderr or done.stdout).decode("utf-8", "replace").split("\n")
    return next((line.strip()[:300] for line in lines if line.strip()), f"exit code {done.returncode}")
