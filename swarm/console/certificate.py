"""Certificates for a console that other machines reach: given, or made for this flight."""

import ipaddress
import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from swarm.errors import InputError, Problem, reason
from swarm.files import read_bytes

LARGEST = 1 << 20
"""Bytes of a file with a certificate and its key."""
_VALID = timedelta(days=2)
_EARLY = timedelta(hours=1)
"""By how much clocks of browsers may be behind."""


def read_certificate(path: Path) -> bytes:
    """Return a PEM file with a certificate and its private key, after it was tried."""
    pem = read_bytes(path, LARGEST)
    try:
        tls_context(pem)
    except (ssl.SSLError, OSError, ValueError) as error:
        expected = "a certificate and its private key in PEM, without passphrase"
        words = f"expected {expected}: {reason(error)}"
        raise InputError([Problem(str(path), words)]) from None
    return pem


def self_signed(hosts: list[str], now: datetime | None = None) -> bytes:
    """Return a certificate for names and addresses of this machine, and its private key, in PEM."""
    now = now or datetime.now(UTC)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "swarm console")])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLY)
        .not_valid_after(now + _VALID)
        .add_extension(
            x509.SubjectAlternativeName([_identity(host) for host in hosts]), critical=False
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return certificate.public_bytes(serialization.Encoding.PEM) + private


def fingerprint(pem: bytes) -> str:
    """Return the SHA-256 of the first certificate, as browsers show it."""
    digest = x509.load_pem_x509_certificates(pem)[0].fingerprint(hashes.SHA256())
    return digest.hex(":").upper()


def tls_context(pem: bytes) -> ssl.SSLContext:
    """Return a server's context; the key is in a file of this account alone, and only meanwhile."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    with TemporaryDirectory() as folder:
        path = Path(folder, "console.pem")
        path.touch(0o600)
        path.write_bytes(pem)
        context.load_cert_chain(path, password=_no_passphrase)
    return context


def _no_passphrase() -> str:
    """Answer OpenSSL, which would ask on the terminal."""
    return ""


def _identity(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
