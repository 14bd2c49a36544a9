"""`residuum serve` with a certificate speaks HTTPS, and refuses files that are none."""

import shutil
import ssl
import subprocess
import sys
import urllib.request

import pytest

from residuum.service.cli import run


@pytest.fixture
def certificate(tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("NO OPENSSL HERE, so HTTPS was not tried")
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    command += ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    files = tmp_path / "certificate.pem", tmp_path / "key.pem"
    subprocess.run(
        [*command, "-out", files[0], "-keyout", files[1]], check=True, capture_output=True
    )
    return files


def test_https_with_the_certificate_of_the_settings(certificate, tmp_path, monkeypatch):
    monkeypatch.setenv("RESIDUUM_TLS_CERTIFICATE", str(certificate[0]))
    monkeypatch.setenv("RESIDUUM_TLS_KEY", str(certificate[1]))
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "serve",
        "--port",
        "0",
        "--data",
        str(tmp_path),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
        try:
            greeting = service.stdout.readline()
            assert greeting.startswith("Residuum is at https://127.0.0.1:")
            trusted = ssl.create_default_context(cafile=certificate[0])
            with urllib.request.urlopen(
                greeting.split()[-1] + "health/live", context=trusted, timeout=30
            ) as answer:
                assert answer.status == 200
                assert answer.headers["Strict-Transport-Security"] == "max-age=31536000"
        finally:
            service.terminate()


def test_files_that_are_no_certificate_are_refused_in_one_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "x.pem").write_text("no certificate")
    for name in ("CERTIFICATE", "KEY"):
        monkeypatch.setenv(f"RESIDUUM_TLS_{name}", str(tmp_path / "x.pem"))
    assert run(["serve", "--port", "0", "--data", str(tmp_path)]) == 2
    assert "tls_certificate" in capsys.readouterr().err
