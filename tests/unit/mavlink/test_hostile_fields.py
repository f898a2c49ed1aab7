"""Each field of each message at the edges of its type, and each message cut off anywhere: none stops the agent."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from math import inf, isfinite, nan
from random import Random
from typing import Any

import pytest
from fastcrc.crc16 import mcrf4xx

from companion.core.estimation.corrections import VelocityCorrection
from companion.core.estimation.vehicle import VehicleTracker
from companion.mavlink.codec import mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, Telemetry, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from tests.fuzz.fleet import Hostile, HostileFleet
from tests.fuzz.mavlink import INTEGERS, MESSAGES
from tests.fuzz.plant import Plant

NOW_S = 100.0
LARGEST_FLOAT = 3.4028234e38
EDGES = (nan, inf, -inf, LARGEST_FLOAT, -LARGEST_FLOAT, 1e-45, -0.0, 1e3)
BOTH = pytest.mark.parametrize("kind", list(AutopilotKind))
READ = tuple(dict.fromkeys(MESSAGES))  # each message that the agent reads


def packet(message: Any, system: int = 1, component: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component)))


def edged(build: Any, plant: Plant, now_s: float) -> Iterator[Any]:
    """The message with one field changed, once for each edge of its type."""
    like = build(plant, now_s)
    for name, type_name in zip(like.fieldnames, like.fieldtypes, strict=True):
        if type_name == "char":
            continue
        edges = EDGES if type_name in ("float", "double") else (*INTEGERS[type_name], 1)
        for edge in edges:
            message = build(plant, now_s)
            value = getattr(message, name)
            places = range(len(value)) if isinstance(value, list | tuple) else (None,)
            for at in places:
                setattr(message, name, edge if at is None else [edge if i == at else v for i, v in enumerate(value)])
                yield message


def cut(whole: bytes, length: int) -> bytes:
    """A packet with the first `length` bytes of its payload, and a good checksum."""
    extra = bytes((mavlink.mavlink_map[int.from_bytes(whole[7:10], "little")].crc_extra,))
    head = bytes((whole[0], length)) + whole[2 : 10 + length]
    return head + mcrf4xx(head[1:] + extra).to_bytes(2, "little")


def numbers_of(state: VehicleState) -> list[float]:
    error = state.position_error
    return [
        *state.position_enu_m,
        *state.velocity_enu_m_s,
        state.roll_rad,
        state.pitch_rad,
        state.yaw_rad,
        state.thrust_norm,
        state.held_back_m,
        *((error.horizontal_m, error.vertical_m) if error else ()),
    ]


def tracker() -> VehicleTracker:
    """With a position in the frame of the fleet."""
    made = VehicleTracker((47.0, 8.0, 400.0), velocity_correction=VelocityCorrection(2.0))
    translator, plant = Translator(1, AutopilotKind.PX4), Plant((1.0, 2.0, 3.0))
    for ticks in range(3):
        now_s = NOW_S + 0.02 * ticks
        made.fold([s for build in READ for s in translator.telemetry(packet(build(plant, now_s)), now_s)])
    assert made.state.position_time_s > 0.0
    return made


@BOTH
@pytest.mark.parametrize("build", READ, ids=lambda build: build.__name__[1:])
def test_a_field_at_an_edge_of_its_type_leaves_a_finite_state(kind: AutopilotKind, build: Any) -> None:
    translator, tracked, plant = Translator(1, kind), tracker(), Plant((1.0, 2.0, 3.0))
    for ticks, message in enumerate(edged(build, plant, NOW_S + 0.1)):
        now_s = NOW_S + 0.1 + 0.02 * ticks
        samples = translator.telemetry(packet(message), now_s)
        state, _ = tracked.fold(samples)
        assert all(map(isfinite, numbers_of(state))), message
        assert max(map(abs, state.velocity_enu_m_s)) <= 101.0


@BOTH
def test_every_message_at_an_edge_of_all_its_fields_is_read_or_refused(kind: AutopilotKind) -> None:
    """Of any id, also those that the agent does not read."""
    translator, random = Translator(1, kind), Random(5)
    for message_id in sorted(mavlink.mavlink_map):
        for _ in range(3):
            payload = random.choice((bytes(255), b"\xff" * 255, random.randbytes(255)))
            size = mavlink.mavlink_map[message_id].unpacker.size
            head = bytes((0xFD, 0, 0, 0, 0, 1, 1)) + message_id.to_bytes(3, "little")
            for length in {0, 1, size // 2, size, 255}:
                translator.telemetry(cut(head + payload, length), NOW_S)


@BOTH
def test_a_message_cut_off_anywhere_has_zeros_in_place_of_the_rest(kind: AutopilotKind) -> None:
    """MAVLink 2 does not send trailing zeros, so any length may come, also none."""
    plant = Plant((1.0, 2.0, 3.0))
    for build in READ:
        whole = packet(build(plant, NOW_S))
        tracked = tracker()
        for length in range(len(whole) - 12, -1, -1):
            translator = Translator(1, kind)
            state, _ = tracked.fold(translator.telemetry(cut(whole, length), NOW_S + 0.1))
            assert all(map(isfinite, numbers_of(state)))
            assert not translator.rejected or set(translator.rejected) <= {"ATTITUDE_INVALID", "AUTOPILOT_OTHER_MAKE"}


@BOTH
@pytest.mark.parametrize(("system", "component"), [(1, 0), (1, 191), (1, 255), (2, 1), (0, 1), (255, 190)])
def test_nothing_of_another_system_or_component_is_used(kind: AutopilotKind, system: int, component: int) -> None:
    translator, plant = Translator(1, kind), Plant((1.0, 2.0, 3.0))
    for build in READ:
        for message in edged(build, plant, NOW_S):
            assert translator.telemetry(packet(message, system, component), NOW_S) == []
    assert not translator.rejected


@pytest.fixture(scope="module")
def formation() -> HostileFleet:
    fleet = HostileFleet(Random(0))
    for _ in range(10):
        fleet.tick()
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        assert all(reply.accepted for reply in fleet.command(name).values())
        for _ in range(100 if name is CommandName.TAKEOFF else 60):
            fleet.tick()
    assert {agent.phase for agent in fleet.agents.values()} == {FlightPhase.FORMATION}
    return fleet


@pytest.mark.parametrize("build", READ, ids=lambda build: build.__name__[1:])
def test_a_field_at_an_edge_of_its_type_stops_no_agent_in_formation(formation: HostileFleet, build: Any) -> None:
    """Each beside the true telemetry of a tick. `HostileFleet.tick` checks setpoints and all that is sent."""
    fleet = deepcopy(formation)
    translator = Translator(2, AutopilotKind.PX4)
    for message in edged(build, fleet.plants[2], fleet.now_s):
        samples: list[Telemetry] = translator.telemetry(packet(message, system=2), fleet.now_s)
        fleet.tick({i: Hostile(telemetry=samples if i == 2 else ()) for i in fleet.agents})
        fleet.tick()
    for _ in range(50):
        fleet.tick()
    state = fleet.statuses[2]
    assert all(map(isfinite, (*state.motion.position_enu_m, *state.motion.velocity_enu_m_s)))
