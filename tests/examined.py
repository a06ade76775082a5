"""The examination that ``otmcp verify`` makes in a process of its own, made in this one."""

from __future__ import annotations

from pathlib import Path

from pytest_otmcp.cli.examination import Certificate, Examined, examine

__all__ = ["verify"]


def verify(certificate: Path, record: Path) -> Examined:
    """Examine a certificate with its record."""
    return examine(record, certificate=Certificate(name=str(certificate), content=certificate.read_bytes()))
