"""Certificates of authority and participants."""

from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.x509.oid import ExtendedKeyUsageOID
from hypothesis import given
from hypothesis import strategies as st

from companion.security.admission import (
    AUTHORITY_DAYS,
    HASH,
    authority_certificate,
    certificate_pem,
    common_name,
    issued_by,
    key_pem,
    new_key,
    organization,
    participant_certificate,
    read_certificate,
    read_key,
)
from companion.security.names import parse_common_name

NOW = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)
KEY, LEAF_KEY = new_key(), new_key()
AUTHORITY = authority_certificate("alpha", KEY, NOW)


def leaf(days: int = 365, now: datetime = NOW) -> x509.Certificate:
    return participant_certificate(parse_common_name("vehicle-3.2"), LEAF_KEY.public_key(), AUTHORITY, KEY, now, days)


def test_a_certificate_of_a_participant_is_for_both_ends_of_tls_and_signs_no_other() -> None:
    certificate = leaf()
    extensions = certificate.extensions
    assert (common_name(certificate), organization(certificate)) == ("vehicle-3.2", "alpha")
    assert not extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert set(extensions.get_extension_for_class(x509.ExtendedKeyUsage).value) == {
        ExtendedKeyUsageOID.SERVER_AUTH,
        ExtendedKeyUsageOID.CLIENT_AUTH,
    }
    names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["vehicle-3.2"]
    assert certificate.not_valid_before_utc == NOW - timedelta(hours=1)
    assert certificate.not_valid_after_utc == NOW + timedelta(days=365)
    assert certificate.public_key() == LEAF_KEY.public_key()
    assert isinstance(LEAF_KEY.curve, ec.SECP256R1)
    assert leaf().serial_number != certificate.serial_number


def test_the_authority_signs_participants_and_no_other_authority() -> None:
    constraints = AUTHORITY.extensions.get_extension_for_class(x509.BasicConstraints).value
    assert (constraints.ca, constraints.path_length) == (True, 0)
    assert AUTHORITY.not_valid_after_utc == NOW + timedelta(days=AUTHORITY_DAYS)
    with pytest.raises(ValueError, match="expected ROLE-ID"):
        parse_common_name(common_name(AUTHORITY))


def test_another_authority_of_the_same_name_did_not_issue_it() -> None:
    assert issued_by(leaf(), AUTHORITY)
    assert not issued_by(leaf(), authority_certificate("alpha", new_key(), NOW))
    assert not issued_by(leaf(), authority_certificate("beta", KEY, NOW))


def test_no_certificate_outlives_its_authority() -> None:
    late = NOW + timedelta(days=AUTHORITY_DAYS - 10)
    assert leaf(10, late).not_valid_after_utc == AUTHORITY.not_valid_after_utc
    with pytest.raises(ValueError, match="expected 1 to 10: the authority ends on 2036-11-19"):
        leaf(11, late)


def test_keys_and_certificates_are_read_as_they_were_written() -> None:
    assert read_certificate(certificate_pem(leaf())).public_key() == LEAF_KEY.public_key()
    assert read_key(key_pem(KEY)).public_key() == KEY.public_key()


@pytest.mark.parametrize("other", [ed25519.Ed25519PrivateKey.generate(), ec.generate_private_key(ec.SECP384R1())])
def test_keys_of_other_kinds_are_refused(other: ed25519.Ed25519PrivateKey | ec.EllipticCurvePrivateKey) -> None:
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    with pytest.raises(ValueError, match="not an EC P-256 private key"):
        read_key(other.private_bytes(encoding, form, serialization.NoEncryption()))


def test_a_key_with_a_password_is_refused() -> None:
    password = serialization.BestAvailableEncryption(b"password")
    with pytest.raises(ValueError, match="without password"):
        read_key(KEY.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, password))


def test_a_certificate_without_organization_is_refused() -> None:
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "vehicle-1")])
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(KEY.public_key())
    built = builder.serial_number(1).not_valid_before(NOW).not_valid_after(NOW + timedelta(days=1)).sign(KEY, HASH)
    with pytest.raises(ValueError):
        read_certificate(certificate_pem(built))


@given(st.binary(max_size=200), st.integers(0, 2000))
def test_damaged_certificates_and_keys_raise_the_one_error(junk: bytes, position: int) -> None:
    for read, good in ((read_certificate, certificate_pem(AUTHORITY)), (read_key, key_pem(KEY))):
        for data in (junk, good[:position] + junk + good[position + len(junk) :]):
            try:
                read(data)
            except ValueError as error:
                assert len(str(error)) < 100
