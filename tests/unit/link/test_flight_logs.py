"""Lists and logs of autopilots whose numbers begin anywhere and have gaps, over links that lose packets."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from pathlib import Path
from random import Random

import pytest

from companion.link.flight_logs import FlightLogs, LogEntry
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink


class Autopilot:
    """Answers requests with the logs that it has, as numbers with sizes; `number` and `last` are what its entries say."""

    def __init__(
        self, logs: dict[int, int], number: int | None = None, last: int | None = None, loss: float = 0.0
    ) -> None:
        self.logs = logs
        self.number = len(logs) if number is None else number
        self.last = max(logs, default=0) if last is None else last
        self.asked: list[MavlinkMessage] = []
        self._loss, self._lottery = loss, Random(3)
        self._codec, self._client = MavlinkCodec(1, 1), MavlinkCodec(255, 190)
        self.flight_logs = FlightLogs(1, self.receive)

    def content(self, number: int) -> bytes:
        return Random(number).randbytes(self.logs[number])

    def receive(self, data: bytes) -> None:
        for message in self._client.decode(data):
            self.asked.append(message)
            asyncio.get_running_loop().call_soon(self._send, list(self._answers(message)))

    def _answers(self, message: MavlinkMessage) -> Iterable[MavlinkMessage]:
        if message.get_type() == "LOG_REQUEST_LIST":
            if not self.logs:
                yield mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0)
            for number, size in self.logs.items():
                yield mavlink.MAVLink_log_entry_message(
                    number, self.number, self.last, 1_700_000_000 * bool(size), size
                )
        elif message.get_type() == "LOG_REQUEST_DATA":
            content = self.content(message.id)
            for offset in range(message.ofs, min(message.ofs + message.count, len(content)), 90):
                part = content[offset : min(offset + 90, message.ofs + message.count)]
                yield mavlink.MAVLink_log_data_message(message.id, offset, len(part), list(part.ljust(90, b"\0")))

    def _send(self, messages: list[MavlinkMessage]) -> None:
        packets = [self._codec.encode(message) for message in messages]
        self.flight_logs.receive([one for one in packets if self._lottery.random() >= self._loss])

    def listed(self) -> list[tuple[int, int]]:
        async def entries() -> tuple[LogEntry, ...]:
            return await self.flight_logs.entries()

        return [(log.id, log.size_bytes) for log in asyncio.run(entries())]

    def downloaded(self, number: int, path: Path) -> bytes:
        async def download() -> None:
            async for _ in self.flight_logs.download(LogEntry(number, None, self.logs[number]), path):
                pass

        asyncio.run(download())
        return path.read_bytes()

    def requests(self, kind: str) -> int:
        return sum(message.get_type() == kind for message in self.asked)


@pytest.mark.parametrize(
    "logs",
    [
        {1: 2000, 2: 3000, 3: 0, 4: 0, 5: 0},
        {248: 2000, 249: 3000, 250: 900},
        {5: 2000, 9: 3000, 12: 10},
        {0: 0, 7: 1},
        {4: 4, 3: 3, 2: 2},
        {65534: 1},
        {},
    ],
)
def test_a_list_is_read_as_it_is(logs: dict[int, int]) -> None:
    autopilot = Autopilot(logs)
    assert autopilot.listed() == sorted(logs.items())
    assert autopilot.requests("LOG_REQUEST_LIST") == 1


@pytest.mark.parametrize(("number", "last"), [(3, 3), (3, 2), (1, 0)])
def test_more_entries_than_the_list_says_are_kept(number: int, last: int) -> None:
    assert Autopilot({0: 0, 1: 2000, 2: 3000, 3: 900}, number, last).listed() == [
        (0, 0),
        (1, 2000),
        (2, 3000),
        (3, 900),
    ]


def test_a_list_that_says_more_than_it_has_ends() -> None:
    autopilot = Autopilot({3: 30, 5: 50}, number=9, last=9)
    assert autopilot.listed() == [(3, 30), (5, 50)]
    assert autopilot.requests("LOG_REQUEST_LIST") == 4


def test_lost_entries_are_asked_for_again() -> None:
    logs = {number: number for number in range(100, 140)}
    assert Autopilot(logs, loss=0.3).listed() == sorted(logs.items())


@pytest.mark.parametrize("size", [1, 90, 91, 46_080, 46_081, 100_003])
def test_a_log_arrives_byte_by_byte(size: int, tmp_path: Path) -> None:
    autopilot = Autopilot({17: size})
    assert autopilot.downloaded(17, tmp_path / "log") == autopilot.content(17)
    assert autopilot.requests("LOG_REQUEST_DATA") == -(-size // 46_080)
    assert autopilot.requests("LOG_REQUEST_END") == 1


def test_lost_data_is_asked_for_again(tmp_path: Path) -> None:
    autopilot = Autopilot({17: 20_003}, loss=0.1)
    assert autopilot.downloaded(17, tmp_path / "log") == autopilot.content(17)


def test_an_empty_log_is_an_empty_file(tmp_path: Path) -> None:
    assert Autopilot({17: 0}).downloaded(17, tmp_path / "log") == b""
