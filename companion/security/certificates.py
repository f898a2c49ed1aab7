"""X.509 certificates of a fleet: EC P-256, one authority that signs all participants. No files, no clocks."""

from __future__ import annotations

from datetime import datetime, timedelta

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes, PublicKeyTypes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from companion.security.names import ParticipantName

AUTHORITY_DAYS = 3650
BACKDATED = timedelta(hours=1)  # so that a board whose clock is a little slow accepts a new certificate
HASH = hashes.SHA256()
UNUSABLE = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    InvalidSignature,
    x509.InvalidVersion,
    x509.DuplicateExtension,
)
"""What `cryptography` raises for keys and certificates that cannot be used."""


def new_key() -> ec.EllipticCurvePrivateKey:
    """A new P-256 key."""
    return ec.generate_private_key(ec.SECP256R1())


def authority_certificate(fleet: str, key: ec.EllipticCurvePrivateKey, now: datetime) -> x509.Certificate:
    """The self-signed certificate of a fleet's authority, valid for AUTHORITY_DAYS."""
    subject = _subject(f"{fleet} authority", fleet)
    usage = _key_usage(digital_signature=True, key_cert_sign=True, crl_sign=True)
    return (
        _builder(subject, subject, key.public_key(), now, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, HASH)
    )


def participant_certificate(
    name: ParticipantName,
    public_key: ec.EllipticCurvePublicKey,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    now: datetime,
    days: int,
) -> x509.Certificate:
    """A certificate for both ends of a TLS connection. Raises ValueError where it would outlive the authority's."""
    last = (authority.not_valid_after_utc - now).days
    if not 1 <= days <= last:
        raise ValueError(f"{days} days, expected 1 to {last}: the authority ends on {day(authority)}")
    usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key())
    return (
        _builder(_subject(str(name), organization(authority)), authority.subject, public_key, now, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(digital_signature=True), critical=True)
        .add_extension(usages, critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(str(name))]), critical=False)
        .add_extension(signer, critical=False)
        .sign(authority_key, HASH)
    )


def read_certificate(pem: bytes) -> x509.Certificate:
    """The certificate in a PEM file, with a P-256 key and a readable subject. Raises ValueError."""
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        is_p256 = public_key_of(certificate) is not None
        common_name(certificate)
        organization(certificate)
    except UNUSABLE as error:
        raise ValueError("is not a certificate of a fleet in PEM form") from error
    if not is_p256:
        raise ValueError("its key is not EC P-256")
    return certificate


def read_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    """The P-256 key in a PEM file without password. Raises ValueError, which does not contain the key."""
    try:
        key: PrivateKeyTypes | None = serialization.load_pem_private_key(pem, password=None)
    except UNUSABLE:
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise ValueError("is not an EC P-256 private key in PEM form without password")
    return key


def public_key_of(certificate: x509.Certificate) -> ec.EllipticCurvePublicKey | None:
    """The key, None where it is not on P-256."""
    return p256(certificate.public_key())


def p256(key: PublicKeyTypes) -> ec.EllipticCurvePublicKey | None:
    """The key where it is one on P-256, else None."""
    return key if isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP256R1) else None


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Whether the authority's key signed the certificate in the authority's name."""
    try:
        certificate.verify_directly_issued_by(authority)
    except UNUSABLE:
        return False
    return True


def common_name(certificate: x509.Certificate) -> str:
    """The one common name of the subject. Raises ValueError."""
    return _one(certificate, NameOID.COMMON_NAME, "common name")


def organization(certificate: x509.Certificate) -> str:
    """The one organization of the subject: the name of the fleet. Raises ValueError."""
    return _one(certificate, NameOID.ORGANIZATION_NAME, "organization")


def serial_of(certificate: x509.Certificate) -> str:
    """The serial number in hexadecimal, without leading zeros."""
    return f"{certificate.serial_number:x}"


def day(certificate: x509.Certificate) -> str:
    """The last day of validity (UTC), like 2027-11-22."""
    return f"{certificate.not_valid_after_utc:%Y-%m-%d}"


def certificate_pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """The private key without password: an agent must start without a person."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def key_der(key: ec.EllipticCurvePublicKey) -> bytes:
    """The public key as SubjectPublicKeyInfo; 91 bytes."""
    return key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


def _one(certificate: x509.Certificate, attribute: x509.ObjectIdentifier, words: str) -> str:
    values = [found.value for found in certificate.subject.get_attributes_for_oid(attribute)]
    if len(values) != 1 or not isinstance(values[0], str):
        raise ValueError(f"its subject has {len(values)} entries for the {words}, expected one")
    return values[0]


def _subject(name: str, fleet: str) -> x509.Name:
    return x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, name), x509.NameAttribute(NameOID.ORGANIZATION_NAME, fleet)]
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _key_usage(*, digital_signature: bool, key_cert_sign: bool = False, crl_sign: bool = False) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=digital_signature,
        key_cert_sign=key_cert_sign,
        crl_sign=crl_sign,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
