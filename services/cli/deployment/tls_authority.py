"""A certificate authority (CA) of one's own in PEM files, and the TLS certificates of workers that it signs."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from capture2vr.errors import BadInput
from capture2vr.process.atomic_write import atomic_write

CA_DAYS = 3650
SERVER_DAYS = 825  # longest that TLS clients of the large vendors accept
RENEW_DAYS = 30  # a certificate that ends sooner is replaced

_SLACK = timedelta(hours=1)  # clocks of machines differ


def make_authority(certificate: Path, key: Path) -> None:
    """Make a CA: its certificate, and its private key (mode 0600)."""
    private = ec.generate_private_key(ec.SECP256R1())
    name = _common_name("capture2vr")
    built = _builder(name, name, private.public_key(), CA_DAYS)
    built = built.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    built = built.add_extension(_usage(signs_certificates=True), critical=True)
    built = built.add_extension(x509.SubjectKeyIdentifier.from_public_key(private.public_key()), critical=False)
    write_private(key, _key_pem(private))
    write_private(certificate, _certificate_pem(built.sign(private, hashes.SHA256())))


def make_server_certificate(
    certificate: Path, key: Path, hosts: Iterable[str], *, authority: Path, authority_key: Path
) -> None:
    """Make a private key (mode 0600), and a certificate for these host names, signed by the CA. Raises BadInput."""
    ca, signer = _read_authority(authority, authority_key)
    private, names = ec.generate_private_key(ec.SECP256R1()), list(hosts)
    built = _builder(_common_name(names[0]), ca.subject, private.public_key(), SERVER_DAYS)
    for extension, critical in (
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (_usage(signs_certificates=False), True),
        (x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), False),
        (x509.SubjectAlternativeName([x509.DNSName(name) for name in names]), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), False),
    ):
        built = built.add_extension(extension, critical=critical)
    # The key first: a crash between the two leaves a pair that does not match, which the next run replaces.
    write_private(key, _key_pem(private))
    write_private(certificate, _certificate_pem(built.sign(signer, hashes.SHA256())))


def is_current(certificate: Path, key: Path, authority: Path, hosts: Iterable[str]) -> bool:
    """Whether certificate and key are a pair, signed by this CA, for all these names, and valid for RENEW_DAYS more."""
    try:
        found = x509.load_pem_x509_certificate(certificate.read_bytes())
        ca = x509.load_pem_x509_certificate(authority.read_bytes())
        private = serialization.load_pem_private_key(key.read_bytes(), password=None)
        found.verify_directly_issued_by(ca)
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except Exception:  # noqa: BLE001 - whatever is wrong with the files, a new certificate mends it
        return False
    left = found.not_valid_after_utc - datetime.now(UTC)
    if not set(hosts) <= set(names.get_values_for_type(x509.DNSName)):
        return False
    return private.public_key() == found.public_key() and left > timedelta(days=RENEW_DAYS)


def write_private(path: Path, data: bytes) -> None:
    """Replace a file atomically; only its owner can read it, from its first byte on (mode 0600)."""
    with atomic_write(path) as fresh:
        fresh.touch(mode=0o600)
        fresh.chmod(0o600)
        fresh.write_bytes(data)


def _read_authority(authority: Path, authority_key: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        ca = x509.load_pem_x509_certificate(authority.read_bytes())
        signer = serialization.load_pem_private_key(authority_key.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(
            f"{authority} and {authority_key} are not a certificate authority and its key ({error}): "
            "put them back, or delete both, and new ones are made"
        ) from None
    if not isinstance(signer, ec.EllipticCurvePrivateKey) or signer.public_key() != ca.public_key():
        raise BadInput(f"{authority_key} is not the key of {authority}: put it back, or delete both")
    return ca, signer


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    built = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key)
    built = built.serial_number(x509.random_serial_number())
    return built.not_valid_before(now - _SLACK).not_valid_after(now + timedelta(days=days))


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    plain = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)


def _certificate_pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)
