"""Host names: what is refused, and that it is what Python's own codec refuses."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.link.byte_links import LinkError, encoded_host

LABELS = st.text("ab.-", max_size=6) | st.sampled_from(["a" * 63, "a" * 64, "ü", "ü" * 64])


@given(st.lists(LABELS, max_size=4).map(".".join) | st.text(max_size=80).filter(lambda text: "\0" not in text))
@example("")
@example(".")
@example("a.")
@example("a..")
@example("192.168.1.11")
def test_a_host_is_refused_exactly_where_its_lookup_would_raise(host: str) -> None:
    try:
        expected = host.encode("idna")
    except UnicodeError:
        with pytest.raises(LinkError, match="neither an address nor a name"):
            encoded_host(host)
    else:
        assert encoded_host(host) == expected


def test_a_zero_byte_is_refused() -> None:
    with pytest.raises(LinkError, match="zero byte"):
        encoded_host("a\0b")
