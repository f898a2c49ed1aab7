"""The checksum, beside another implementation and the check value of the catalogue of CRCs."""

from __future__ import annotations

from fastcrc import crc16
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.generated import mcrf4xx


def test_the_check_value() -> None:
    assert mcrf4xx(b"123456789") == 0x6F91


@given(st.binary(max_size=300))
def test_it_is_that_of_another_library(data: bytes) -> None:
    assert mcrf4xx(data) == mcrf4xx(bytearray(data)) == crc16.mcrf4xx(data)


@given(st.binary(max_size=40), st.binary(max_size=40))
def test_it_goes_on_behind_other_bytes(first: bytes, second: bytes) -> None:
    assert mcrf4xx(second, mcrf4xx(first)) == mcrf4xx(first + second)
