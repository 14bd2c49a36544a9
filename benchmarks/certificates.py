"""Certificates for one run: of this computer, of an authority of our own, and of clients that it knows."""

from __future__ import annotations

import subprocess
from pathlib import Path

OPENSSL = "openssl"
_NEW = [
    "req",
    "-newkey",
    "ec",
    "-pkeyopt",
    "ec_paramgen_curve:prime256v1",
    "-nodes",
    "-days",
    "2",
    "-subj",
]


def certificate_and_key(
    folder: Path, name: str = "localhost", *, by: tuple[Path, Path] | None = None
) -> tuple[Path, Path]:
    """PEM files of a certificate for a name and this computer, and its key; signed `by` an authority's, or by itself.

    Raises FileNotFoundError where OpenSSL is not installed.
    """
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    names = ["-addext", f"subjectAltName=DNS:{name},DNS:localhost,IP:127.0.0.1"]
    if by is None:
        _run([*_NEW, f"/CN={name}", "-x509", *names, "-keyout", key, "-out", certificate])
        return certificate, key
    asked, said = folder / f"{name}.csr", folder / f"{name}.cnf"
    said.write_text(names[1] + "\n")
    _run([*_NEW, f"/CN={name}", "-keyout", key, "-out", asked])
    _run(
        [
            "x509",
            "-req",
            "-in",
            asked,
            "-days",
            "2",
            "-CA",
            by[0],
            "-CAkey",
            by[1],
            "-CAcreateserial",
            "-extfile",
            said,
            "-out",
            certificate,
        ]
    )
    return certificate, key


def _run(arguments: list[str | Path]) -> None:
    subprocess.run([OPENSSL, *arguments], check=True, capture_output=True)
