"""A rogue peer publishes on the Zenoh keys of four flying agents: its packets are counted, reported and never used."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from math import nan
from pathlib import Path

import pytest

from common import ROOT, with_fields
from companion.config.file import ConfigError, load
from companion.config.fleet import FleetConfig
from companion.link.fleet.zenoh_session import open_session
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.wire.keys import peer_key
from companion.wire.messages import WIRE_VERSION, encode_peer
from processes import free_fleet_offset
from sitl.links.ports import LOOPBACK, ports_of
from sitl.report.summary import read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(180)]

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
REJECTED = {
    f"{Code.PEER_OTHER_FLEET_FILE} 3",
    f"{Code.PEER_ID_TWICE} 3",
    f"{Code.PEER_NOT_FINITE} 3",
    f"{Code.PEER_POSITION_IMPLAUSIBLE} 3",
    f"{Code.PEER_NOT_A_LEADER} 3",
    f"{Code.WIRE_VERSION_DIFFERS} {WIRE_VERSION + 1}",
    Code.PEER_MALFORMED,
    Code.PEER_KEY_MISMATCH,
}


# Vehicle 3 receives nothing under its own key; under the key of another it is counted as a mismatch by all.
OTHER_KEY = peer_key("platoon", 4)


def rogue_packets(formation_hash: int) -> Iterator[bytes]:
    """False packets of vehicle 3, one of every kind; the last one would pull its neighbours a hundred metres away."""
    packet = PeerPacket(
        sender=Sender(vehicle_id=3, session=1, sequence=10**9, formation_hash=formation_hash),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(100.0, 100.0, 100.0),
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, 0.0),
            state_age_s=0.0,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=2, beacon=LeaderBeacon(1, 0, 10**9)),
        slot=FlownSlot((0.0, 0.0, 0.0)),
    )
    yield encode_peer(with_fields(packet, formation_hash=formation_hash ^ 1))
    yield encode_peer(with_fields(packet, position_enu_m=(nan, 0.0, 0.0)))
    yield encode_peer(with_fields(packet, position_enu_m=(1e9, 0.0, 0.0)))
    yield encode_peer(with_fields(packet, role=Role.LEADER, prc=1))
    good = encode_peer(packet)
    yield bytes((WIRE_VERSION + 1,)) + good[1:]
    yield good[:-7]
    yield good


def written(file: Path, flight: subprocess.Popen[str]) -> FleetConfig:
    """The fleet file, as soon as it is complete."""
    while flight.poll() is None:
        with suppress(ConfigError):  # missing or incomplete
            return load(file, FleetConfig)
        time.sleep(0.05)
    raise AssertionError(flight.communicate()[0])


def test_packets_of_a_rogue_peer_are_counted_and_never_used(tmp_path: Path) -> None:
    out = tmp_path / "out"
    overrides = ["--set", "stand_in.armable_after_s=1", "--set", "timeline[2].for_s=2", "--set", "timeline[3].for_s=8"]
    command = [sys.executable, "-m", "sitl", "fly", str(PLATOON), "--out", str(out), *overrides]
    port_offset = free_fleet_offset()
    flight = subprocess.Popen(
        [*command, "--port-offset", str(port_offset)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    endpoints = [f"tcp/{LOOPBACK}:{ports_of(i, port_offset).zenoh}" for i in (1, 2, 3, 4)]
    formation_hash = written(out / "fleet.yaml", flight).formation_hash()
    logs = [out / f"agent_{i}.log" for i in (1, 2, 3, 4)]  # on the ground a duplicate id refuses prepare
    while not all(log.exists() and "engage -> formation" in log.read_text(encoding="utf-8") for log in logs):
        assert flight.poll() is None
        time.sleep(0.1)
    with closing(open_session([], endpoints)) as rogue:
        while flight.poll() is None:
            for packet in rogue_packets(formation_hash):
                rogue.put(peer_key("platoon", 3), packet)
                rogue.put(OTHER_KEY, packet)
            time.sleep(0.1)
    printed, _ = flight.communicate(timeout=60)

    assert flight.returncode == 0, printed
    summary = read_summary(out / "summary.json")
    assert max(summary.max_distance_m[pair] for pair in ("1-2", "2-3", "3-4")) < 2.0
    for vehicle in summary.vehicles:
        if vehicle.id != 3:  # nothing that comes under its own key is used
            assert vehicle.rejected.keys() >= REJECTED, vehicle.rejected
