"""How many places the live page has for whom, so that strangers who hold theirs for ever shut out no operator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address, ip_network

HOST_PREFIX = 64  # bits: a host can take any IPv6 address of its network


@dataclass(frozen=True, eq=False, slots=True)
class Share:
    """Places that a kind of visitors has for itself: all of them, one address, and one IPv6 network of HOST_PREFIX bits."""

    most: int
    most_of_address: int
    most_of_network: int
    kind: str  # as in "8 live connections KIND are open already"
    advice: str


@dataclass(frozen=True, slots=True)
class Visitor:
    """Who asks for a place."""

    address: str
    share: Share


class Places:
    """Those that are taken."""

    def __init__(self) -> None:
        self._taken: Counter[tuple[Share, str]] = Counter()  # of all ("all"), of each address and of each network

    def refusal(self, visitor: Visitor) -> str:
        """Why there is no place for it, in one line; "" where there is one."""
        for owner, most in _bounds(visitor).items():
            if self._taken[visitor.share, owner] >= most:
                whose = "" if owner == ALL else f" from {owner}"
                what = f"{most} live connections{visitor.share.kind}{whose} are open already, the most at once"
                return f"{what}; {visitor.share.advice}"
        return ""

    @contextmanager
    def taken_by(self, visitor: Visitor) -> Iterator[None]:
        """Meanwhile it has a place."""
        owners = [(visitor.share, owner) for owner in _bounds(visitor)]
        self._taken.update(owners)
        try:
            yield
        finally:
            self._taken.subtract(owners)
            self._taken += Counter()  # forgets those without a place: strangers may come from very many addresses


ALL = "all"


def _bounds(visitor: Visitor) -> dict[str, int]:
    """How many places each of these may have: the address, its network, and all of the visitor's kind."""
    share, network = visitor.share, network_of(visitor.address)
    networks = {network: share.most_of_network} if network else {}
    return {visitor.address: share.most_of_address, **networks, ALL: share.most}


def plain_address(address: str) -> str:
    """In one spelling, without brackets; IPv4 that came to an IPv6 socket as IPv4. A name stays as it is."""
    text = address.strip("[]").lower()
    try:
        parsed = ip_address(text)
    except ValueError:
        return text
    mapped = parsed.ipv4_mapped if isinstance(parsed, IPv6Address) else None
    return str(mapped or parsed)


def network_of(address: str) -> str:
    """The network of HOST_PREFIX bits of an IPv6 address, without the interface; "" for others."""
    try:
        parsed = ip_address(address.partition("%")[0])
    except ValueError:
        return ""
    return str(ip_network((int(parsed), HOST_PREFIX), strict=False)) if isinstance(parsed, IPv6Address) else ""
