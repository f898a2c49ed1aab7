"""A stranger on the fleet's own Zenoh keys, while four real agents fly: counted, reported, and never felt."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from math import nan
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.config_file import ConfigError, load
from companion.link.zenoh_session import open_session
from companion.types import FlightPhase, FlownSlot, LeaderWord, PeerPacket, Role
from companion.wire.keys import peer_key
from companion.wire.peer import encode_peer
from sitl.ports import LOOPBACK, ports_of
from sitl.summary import read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
PORT_OFFSET = 2600
REASONS = (
    "another fleet file",
    "two vehicles with one id",
    "numbers not finite",
    "position not plausible",
    "claims to be leader",
    "wire version 9",
    "malformed peer packet",
    "another vehicle than its key says",
)


LONG_KEY = peer_key("platoon", 3) + "0" * 5000


def lies(formation_hash: int) -> Iterator[bytes]:
    """What vehicle 3 never said, one lie of every kind; the last would pull its neighbours a hundred metres away."""
    packet = PeerPacket(
        vehicle_id=3,
        session=1,
        sequence=10**9,
        formation_hash=formation_hash,
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        position_enu_m=(100.0, 100.0, 100.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        acceleration_enu_m_s2=(0.0, 0.0, 0.0),
        state_age_s=0.0,
        sent_s=0.0,
        prc=2,
        leader_word=LeaderWord(1, 0, 10**9),
        slot=FlownSlot((0.0, 0.0, 0.0)),
    )
    yield encode_peer(replace(packet, formation_hash=formation_hash ^ 1))
    yield encode_peer(replace(packet, position_enu_m=(nan, 0.0, 0.0)))
    yield encode_peer(replace(packet, position_enu_m=(1e9, 0.0, 0.0)))
    yield encode_peer(replace(packet, role=Role.LEADER, prc=1))
    good = encode_peer(packet)
    yield b"\x09" + good[1:]
    yield good[:-7]
    yield good


def written(file: Path, flight: subprocess.Popen[str]) -> FleetConfig:
    """The fleet file, once it is whole."""
    while flight.poll() is None:
        with suppress(ConfigError):  # it is not there yet, or half of it
            return load(file, FleetConfig)
        time.sleep(0.05)
    raise AssertionError(flight.communicate()[0])


def test_a_stranger_on_the_fleets_keys_is_counted_and_never_felt(tmp_path: Path) -> None:
    out = tmp_path / "out"
    # What it says of the leader before the real vehicle 3 says anything is forgotten after 11 s: formation begins later.
    overrides = ["--set", "timeline[2].for_s=13", "--set", "timeline[3].for_s=12"]
    command = [sys.executable, "-m", "sitl", "fly", str(PLATOON), "--out", str(out), *overrides]
    flight = subprocess.Popen(
        [*command, "--port-offset", str(PORT_OFFSET)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    endpoints = [f"tcp/{LOOPBACK}:{ports_of(i, PORT_OFFSET).zenoh}" for i in (1, 2, 3, 4)]
    formation_hash = written(out / "fleet.yaml", flight).formation_hash()
    with closing(open_session([], endpoints)) as stranger:
        while flight.poll() is None:
            for lie in lies(formation_hash):
                stranger.put(peer_key("platoon", 3), lie)
                stranger.put(LONG_KEY, lie)
            time.sleep(0.1)
    printed, _ = flight.communicate(timeout=60)

    assert flight.returncode == 0, printed
    summary = read_summary(out / "summary.json")
    assert max(summary.max_distance_m[pair] for pair in ("1-2", "2-3", "3-4")) < 2.0
    for vehicle in summary.vehicles:
        if vehicle.id == 3:
            continue  # it does not listen to packets of its own key
        counted = " ".join(vehicle.rejected)
        assert [reason for reason in REASONS if reason not in counted] == [], vehicle.rejected
        assert "peer 3" in counted
