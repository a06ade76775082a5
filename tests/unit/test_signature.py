"""Signatures of certificates, by the real ssh-keygen, with keys that are made for the test."""

from __future__ import annotations

import json
import shutil
import subprocess
from datetime import datetime
from pathlib import Path

import pytest

from pytest_otmcp.cli import Refusal, main
from pytest_otmcp.cli.signature import NAMESPACE, Signer, sign, signer
from tests.keys import WHO, new_key, trusted

pytestmark = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")


@pytest.fixture
def key(tmp_path: Path) -> Path:
    return new_key(tmp_path / "key")


@pytest.fixture
def trust(tmp_path: Path, key: Path) -> Path:
    """A file of trusted signers that names the key."""
    return trusted(key, tmp_path / "allowed_signers")


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    file = tmp_path / "certificate.json"
    file.write_text("{}")
    return file


Told = pytest.CaptureFixture[str]


def refused(told: Told, *options: object) -> str:
    code = main(["verify", *map(str, options)])
    sentence = told.readouterr().err
    assert sentence.count("\n") == 1
    return f"{code}: {sentence}"


def test_a_signature_names_its_signer(certificate: Path, key: Path, trust: Path) -> None:
    signature = sign(certificate, key)
    assert signature.name == "certificate.json.sig"
    assert signer(certificate.read_bytes(), signature.read_bytes(), trust) == Signer(WHO)


def test_a_key_that_is_trusted_for_something_else_too_names_its_signer(
    certificate: Path, key: Path, trust: Path, tmp_path: Path
) -> None:
    content, signature = certificate.read_bytes(), sign(certificate, key).read_bytes()
    public = key.with_suffix(".pub").read_text()
    others = tmp_path / "others"
    others.write_text(f'# of ours\n\nsomebody namespaces="git" {public}former valid-before="20200101" {public}')
    with pytest.raises(Refusal, match="refused: the signature of somebody does not hold for this certificate"):
        signer(content, signature, others)
    trust.write_text(others.read_text() + trust.read_text())
    assert signer(content, signature, trust) == Signer(WHO)
    with pytest.raises(Refusal, match="does not hold for this certificate"):
        signer(content + b" ", signature, trust)


@pytest.mark.parametrize(
    ("measured", "holds"),
    [
        ("2024-06-01T12:00:00+00:00", True),
        ("2025-01-02T12:00:00+00:00", False),
        ("2023-01-01T00:00:00+00:00", False),
        ("2999-01-01T00:00:00+00:00", False),
        ("2024-06-01T12:00:00", False),
        ("in June", False),
        (5, False),
    ],
)
def test_a_key_that_has_expired_is_judged_as_of_the_measurement_that_it_signed(
    certificate: Path, key: Path, trust: Path, tmp_path: Path, measured: object, holds: bool
) -> None:
    certificate.write_text(json.dumps({"predicate": {"otmcp": {"measured_at": measured}}}))
    content, signature = certificate.read_bytes(), sign(certificate, key).read_bytes()
    public = key.with_suffix(".pub").read_text()
    trust.write_text(f'{WHO} valid-after="20240101",valid-before="20250101",namespaces="{NAMESPACE}" {public}')
    if not holds:
        with pytest.raises(Refusal, match="refused: the signature of"):
            signer(content, signature, trust)
        return
    found = signer(content, signature, trust)
    assert (found.name, found.as_of) == (WHO, datetime.fromisoformat(str(measured)))
    revoked = tmp_path / "revoked"
    revoked.write_text(public)
    with pytest.raises(Refusal, match="key has expired"):
        signer(content, signature, trust, revoked)


@pytest.mark.parametrize("as_list", [True, False])
def test_a_revoked_key_is_trusted_no_more(
    certificate: Path, key: Path, trust: Path, tmp_path: Path, as_list: bool
) -> None:
    content, signature = certificate.read_bytes(), sign(certificate, key).read_bytes()
    revoked, other = tmp_path / "revoked", new_key(tmp_path / "other")
    for gone, holds in ((other, True), (key, False)):
        public = gone.with_suffix(".pub")
        if as_list:
            subprocess.run([shutil.which("ssh-keygen") or "", "-q", "-k", "-f", str(revoked), str(public)], check=True)
        else:
            revoked.write_bytes(public.read_bytes())
        if holds:
            assert signer(content, signature, trust, revoked) == Signer(WHO)
        else:
            with pytest.raises(Refusal, match="does not hold for this certificate"):
                signer(content, signature, trust, revoked)


@pytest.mark.parametrize(
    ("principals", "told"),
    [("!bad@x,*@x", "*@x"), ('"TUV Sued, Munich"', "TUV Sued, Munich"), ("a@x,b@x", "a@x,b@x")],
)
def test_the_principals_of_a_line_are_told_whole_and_without_those_that_are_excluded(
    certificate: Path, key: Path, trust: Path, principals: str, told: str
) -> None:
    trust.write_text(f'{principals} namespaces="{NAMESPACE}" {key.with_suffix(".pub").read_text()}')
    assert signer(certificate.read_bytes(), sign(certificate, key).read_bytes(), trust) == Signer(told)


def test_anybody_can_check_it_with_ssh_keygen_alone(certificate: Path, key: Path, trust: Path) -> None:
    command = [
        "ssh-keygen",
        "-Y",
        "verify",
        "-f",
        str(trust),
        "-I",
        WHO,
        "-n",
        NAMESPACE,
        "-s",
        str(sign(certificate, key)),
    ]
    subprocess.run(command, input=certificate.read_bytes(), check=True, timeout=60)


def test_another_content_is_not_signed(certificate: Path, key: Path, trust: Path, capsys: Told) -> None:
    sign(certificate, key)
    certificate.write_text('{"awarded": "Gold"}')
    sentence = refused(capsys, certificate, certificate, "--trust", trust)
    assert sentence.startswith(f"1: otmcp: refused: the signature of {WHO} does not hold for this certificate: ")


def test_a_signature_of_somebody_else_is_refused(certificate: Path, tmp_path: Path, trust: Path, capsys: Told) -> None:
    sign(certificate, new_key(tmp_path / "other"))
    sentence = refused(capsys, certificate, certificate, "--trust", trust)
    assert sentence.startswith(
        f"1: otmcp: refused: the signature of the certificate is of nobody whom {trust} trusts: "
    )


def test_a_signature_for_another_purpose_is_refused(certificate: Path, key: Path, trust: Path, capsys: Told) -> None:
    trust.write_text(f"{WHO} {key.with_suffix('.pub').read_text()}")
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", str(key), "-n", "git", str(certificate)]
    subprocess.run(command, check=True, timeout=60, capture_output=True)
    assert "does not hold for this certificate" in refused(capsys, certificate, certificate, "--trust", trust)


def test_what_is_no_signature_is_refused(certificate: Path, trust: Path, capsys: Told) -> None:
    certificate.with_name("certificate.json.sig").write_text("\x1b[2J signed by TUV")
    assert refused(capsys, certificate, certificate, "--trust", trust).startswith("1: otmcp: refused: the signature of")


def test_files_that_are_missing_are_named(certificate: Path, key: Path, trust: Path, capsys: Told) -> None:
    assert refused(capsys, certificate, certificate, "--trust", trust) == (
        f"1: otmcp: refused: {certificate} is not signed: there is no {certificate}.sig\n"
    )
    sign(certificate, key)
    assert refused(capsys, certificate, certificate, "--trust", "nowhere") == (
        "2: otmcp: --trust: nowhere: there is no such file\n"
    )
    assert refused(capsys, certificate, "--trust", trust) == (
        "2: otmcp: --trust: only a certificate is signed; give CERT and RUN\n"
    )


def test_a_key_that_cannot_sign_is_found_before_the_run(tmp_path: Path, certificate: Path, capsys: Told) -> None:
    for key, reason in ((tmp_path / "none", "there is no such key file"), (certificate, "is no SSH key: ")):
        assert main(["certify", "--sign", str(key), "--out", str(tmp_path / "out")]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert reason in told.err


def test_a_machine_without_openssh_is_told_what_is_missing(
    certificate: Path, key: Path, trust: Path, monkeypatch: pytest.MonkeyPatch, capsys: Told
) -> None:
    sign(certificate, key)
    monkeypatch.setenv("PATH", "")
    wanted = "2: otmcp: signatures need ssh-keygen of OpenSSH 8.2 or later, which is not on PATH\n"
    assert refused(capsys, certificate, certificate, "--trust", trust) == wanted
