"""Who gets a place: pure counting. With real sockets: test_access.py and tests/protocol/test_commander.py."""

from __future__ import annotations

from contextlib import ExitStack

import pytest
from aiohttp.test_utils import make_mocked_request

from companion.monitor.access import (
    FOR_OTHERS,
    FOR_THIS_MACHINE,
    FOR_TOKEN,
    MOST_OF_ADDRESS,
    WITHOUT_TOKEN,
    visitor_of,
)
from companion.monitor.api import TOKEN_HEADER, TOKEN_PROTOCOL
from companion.monitor.places import Places, Share, Visitor, network_of, plain_address

TOKEN = "a-token"


def visitor(address: str, share: Share = WITHOUT_TOKEN) -> Visitor:
    return Visitor(plain_address(address), share)


def take(places: Places, stack: ExitStack, *visitors: Visitor) -> int:
    """How many of them got a place."""
    taken = 0
    for one in visitors:
        if not places.refusal(one):
            stack.enter_context(places.taken_by(one))
            taken += 1
    return taken


def test_strangers_with_many_addresses_leave_the_places_of_the_token_alone() -> None:
    places = Places()
    with ExitStack() as stack:
        assert take(places, stack, *(visitor(f"10.0.{n // 200}.{n % 200}") for n in range(1000))) == WITHOUT_TOKEN.most
        operators = [visitor(f"10.0.0.{n}", FOR_TOKEN) for n in range(FOR_TOKEN.most)]
        assert take(places, stack, *operators) == FOR_TOKEN.most
    assert not places.refusal(visitor("10.9.9.9"))


def test_one_address_gets_a_few_and_the_next_gets_some_too() -> None:
    places = Places()
    with ExitStack() as stack:
        assert take(places, stack, *[visitor("10.0.0.1")] * 100) == MOST_OF_ADDRESS
        assert take(places, stack, *[visitor("::ffff:10.0.0.1")] * 100) == 0
        assert "from 10.0.0.1" in places.refusal(visitor("10.0.0.1"))
        assert take(places, stack, *[visitor("10.0.0.2")] * 3) == 3
    assert take(places, stack, visitor("10.0.0.1")) == 1  # those that left have left their places


def test_a_host_with_a_whole_ipv6_network_counts_as_one() -> None:
    places = Places()
    with ExitStack() as stack:
        many = [visitor(f"2001:db8::{n:x}") for n in range(1000)]
        assert take(places, stack, *many) == WITHOUT_TOKEN.most_of_network
        assert "from 2001:db8::/64" in places.refusal(many[-1])
        assert take(places, stack, *[visitor("2001:db8:0:1::1")] * 100) == MOST_OF_ADDRESS


def test_a_program_that_leaks_sockets_with_the_token_leaves_places_for_other_operators() -> None:
    places = Places()
    with ExitStack() as stack:
        assert take(places, stack, *[visitor("10.0.0.1", FOR_TOKEN)] * 100) == FOR_TOKEN.most_of_address
        assert take(places, stack, *[visitor("10.0.0.2", FOR_TOKEN)] * 8) == 8


@pytest.mark.parametrize(
    ("remote", "share"),
    [("127.0.0.1", FOR_THIS_MACHINE), ("::1", FOR_THIS_MACHINE), ("::ffff:127.0.0.1", FOR_THIS_MACHINE),
     ("192.0.2.7", FOR_OTHERS), ("::ffff:192.0.2.7", FOR_OTHERS), ("fe80::1%eth0", FOR_OTHERS), ("None", FOR_OTHERS)],
)  # fmt: skip
def test_without_a_token_the_places_are_kept_for_this_machine(remote: str, share: Share) -> None:
    request = make_mocked_request("GET", "/", headers={TOKEN_HEADER: ""}).clone(remote=remote)
    assert visitor_of(request, "").share is share


@pytest.mark.parametrize(
    ("header", "protocols", "share"),
    [(TOKEN, "", FOR_TOKEN), ("", f"companion, {TOKEN_PROTOCOL}{TOKEN}", FOR_TOKEN),
     ("", f"{TOKEN_PROTOCOL}{TOKEN}", FOR_TOKEN),
     ("", "", WITHOUT_TOKEN), (TOKEN + "x", "", WITHOUT_TOKEN), ("", f"companion,{TOKEN_PROTOCOL}", WITHOUT_TOKEN),
     ("", TOKEN, WITHOUT_TOKEN), ("", "," * 4000 + TOKEN_PROTOCOL + TOKEN, WITHOUT_TOKEN)],
)  # fmt: skip
def test_the_token_comes_in_a_header_or_as_a_subprotocol(header: str, protocols: str, share: Share) -> None:
    headers = {TOKEN_HEADER: header, "Sec-WebSocket-Protocol": protocols}
    request = make_mocked_request("GET", "/", headers=headers).clone(remote="127.0.0.1")
    assert visitor_of(request, TOKEN).share is share


@pytest.mark.parametrize(
    ("address", "plain", "network"),
    [("10.0.0.1", "10.0.0.1", ""), ("[2001:DB8:0::1]", "2001:db8::1", "2001:db8::/64"), ("::ffff:10.0.0.1", "10.0.0.1", ""),
     ("fe80::1%eth0", "fe80::1%eth0", "fe80::/64"), ("None", "none", ""), ("", "", "")],
)  # fmt: skip
def test_addresses_are_counted_in_one_spelling(address: str, plain: str, network: str) -> None:
    assert plain_address(address) == plain
    assert network_of(plain) == network
