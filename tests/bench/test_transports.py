"""The radio between network namespaces, and the table of the transports. `make transports` has the namespaces themselves."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.bench.hosts import Radio, address
from tests.bench.page import marks, write_between_marks
from tests.bench.programs.transport_vehicle import TransportAges
from tests.bench.transports import MARKS, TransportFigures, table

pytestmark = pytest.mark.long


class Air:
    """A radio whose hosts are sockets of this process."""

    def __init__(self, stack: ExitStack, loss: float, delay_s: float = 0.0) -> None:
        pairs = {host: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for host in (1, 2, 3)}
        self.ends = {host: stack.enter_context(own) for host, (own, _) in pairs.items()}
        devices = {host: stack.enter_context(other).fileno() for host, (_, other) in pairs.items()}
        self.radio = Radio(devices, loss, delay_s)
        self.radio.start()
        stack.callback(self.radio.stop)
        for end in self.ends.values():
            end.settimeout(0.3)

    def received(self, host: int) -> bytes | None:
        try:
            return self.ends[host].recv(2048)
        except TimeoutError:
            return None


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def packet(to: str, version: int = 4) -> bytes:
    return bytes((version << 4,)) + bytes(15) + socket.inet_aton(to) + b"content"


def test_a_packet_goes_to_its_host_and_multicast_to_all_others(stack: ExitStack) -> None:
    air = Air(stack, loss=0.0)
    air.ends[1].send(packet(address(2)))
    assert air.received(2) == packet(address(2))
    air.ends[2].send(packet("239.255.77.1"))
    assert air.received(1) == air.received(3) == packet("239.255.77.1")
    assert air.received(2) is None
    air.ends[3].send(packet(address(1), version=6))
    assert air.received(1) is None
    assert air.radio.sent_bytes == {1: 27, 2: 27, 3: 0}


def test_a_radio_loses_and_delays(stack: ExitStack) -> None:
    lossy = Air(stack, loss=0.5)
    for _ in range(200):
        lossy.ends[1].send(packet(address(2)))
    arrived = 0
    while lossy.received(2):
        arrived += 1
    assert 60 < arrived < 140
    late = Air(stack, loss=0.0, delay_s=0.05)
    sent_s = time.monotonic()
    late.ends[1].send(packet(address(3)))
    assert late.received(3)
    assert time.monotonic() - sent_s >= 0.05


def test_the_table_takes_its_place_in_the_page(tmp_path: Path) -> None:
    rows = [
        TransportFigures("`quic`", 0.1, TransportAges(12.4, 40.0, 99.6, 0.0123, 0.051), 31.4),
        TransportFigures("`tcp` (TLS)", 0.3, None, 0.0),
    ]
    begin, end = marks(MARKS)
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{begin}\nold\n{end}\nafter\n")
    write_between_marks(page, MARKS, table(rows))
    text = page.read_text()
    assert "| `quic` | 10% | 12.4 | 40.0 | 100 | 1.23% | 31 | 5.1% |" in text
    assert "| `tcp` (TLS) | 30% | not connected within 60 s |" in text
    assert "old" not in text
    assert text.endswith(f"{end}\nafter\n")
    page.write_text("no marks")
    with pytest.raises(ValueError, match="expected the lines"):
        write_between_marks(page, MARKS, "")
