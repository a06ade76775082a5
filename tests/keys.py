"""Keys of OpenSSH that are made for a test, and files of trusted signers."""

from __future__ import annotations

import subprocess
from pathlib import Path

from pytest_otmcp.cli.signature import NAMESPACE

__all__ = ["WHO", "new_key", "trusted"]

WHO = "release@acme.example"


def new_key(path: Path) -> Path:
    """Make a key without passphrase, and return its path."""
    command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)]
    subprocess.run(command, check=True, timeout=60)
    return path


def trusted(key: Path, path: Path) -> Path:
    """Write a file that trusts a key for certificates, and return its path."""
    path.write_text(f'{WHO} namespaces="{NAMESPACE}" {key.with_suffix(".pub").read_text()}')
    return path
