"""The loop of `companion mocap`: frames that stop are reported within a second, and the system is connected again."""

from __future__ import annotations

from companion.geometry.capture_axes import CaptureAxes
from companion.ground.mocap.bodies import BodyWatch, CaptureFrame, SeenBody
from companion.ground.mocap.command import LOOK_S, Relay
from companion.types.errors import FailedError

BODY = SeenBody("cf1", (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))


class Flight:
    """A relay over cameras that can be silent or broken, with a clock of its own."""

    def __init__(self) -> None:
        self.now_s, self.silent, self.restarts, self.broken = 100.0, False, 0, ""
        self.said: list[tuple[float, str]] = []
        self.published: list[int] = []
        watch = BodyWatch(CaptureAxes.of("z", "x"), {"cf1": 1}, None, self.now_s)
        self.relay = Relay(self, watch, self, "192.168.1.5", self.say, lambda: self.now_s, self.wait)

    def say(self, line: str) -> None:
        self.said.append((self.now_s, line))

    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    def receive(self, within_s: float) -> CaptureFrame | None:
        if self.broken:
            raise FailedError(self.broken)
        self.now_s += within_s if self.silent else 0.01
        return None if self.silent else CaptureFrame(self.now_s, 0.005, (BODY,))

    def restart(self) -> None:
        self.restarts += 1

    def publish(self, vehicle_id: int, *_: object) -> None:
        self.published.append(vehicle_id)

    def fly(self, seconds: float) -> list[str]:
        end_s, before = self.now_s + seconds, len(self.said)
        while self.now_s < end_s:
            self.relay.step()
        return [line for _, line in self.said[before:]]


def test_poses_are_published_and_the_summary_is_said_on_change_alone():
    flight = Flight()
    assert flight.fly(8.0)[1:] == []
    assert len(flight.published) >= 799
    assert "1 of 1 bodies tracked, 100 poses/s each, 5 ms old, 0 refused" in flight.said[0][1]


def test_silence_is_reported_within_a_second_and_its_end():
    flight = Flight()
    flight.fly(5.0)
    flight.silent, began_s = True, flight.now_s
    assert flight.fly(4.0) == ["no frame from 192.168.1.5 for 0.5 s: no poses are published; waiting for it"]
    assert flight.said[-1][0] - began_s <= 0.5 + 2.0 * LOOK_S
    flight.silent = False
    assert flight.fly(0.1)[0].startswith("frames from 192.168.1.5 again, after 4.")


def test_a_long_silence_connects_again_and_again():
    flight = Flight()
    flight.fly(5.0)
    flight.silent = True
    lines = flight.fly(32.0)
    assert flight.restarts == 3
    assert sum("connecting again" in line for line in lines) == 3


def test_a_reading_process_that_ends_is_started_again():
    flight = Flight()
    flight.fly(5.0)
    flight.broken = "natnet cannot read 192.168.1.5: a reason"
    assert flight.fly(3.5)[0] == flight.broken
    assert 3 <= flight.restarts <= 4
    flight.broken = ""
    assert any(line.startswith("frames from 192.168.1.5 again") for line in flight.fly(0.2))
