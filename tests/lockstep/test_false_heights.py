"""A peer, a leader or a reference that climbs above the ceiling and sinks below the ground takes no follower with it."""

from __future__ import annotations

from math import cos, sin
from pathlib import Path

import numpy as np
import pytest

from common import with_fields
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.formation import FormationState
from companion.types.peers import PeerPacket
from lockstep_fleet import EnteringFleet, scenario_of
from sitl.report.metrics import SAMPLE_S

SLOTS = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
LEADER, FOLLOWER = 1, 2
HEIGHT_M, CEILING_M, CLEARANCE_M, FLOOR_M = 5.0, 8.0, 0.5, 0.5
SWING_M, RATE_1_S = 6.0, 0.5  # from 11 m down to 1 m below the ground, at up to 3 m/s
LASTS_S = 10.0
OVERSHOOT_M = 0.05
BOTH = [AutopilotKind.PX4, pytest.param(AutopilotKind.ARDUPILOT, marks=pytest.mark.long)]


def swing(after_s: float) -> tuple[float, float, float]:
    """Height, climb rate and its change; each is the derivative of the one before."""
    s, c = sin(RATE_1_S * after_s), cos(RATE_1_S * after_s)
    return HEIGHT_M + SWING_M * s, SWING_M * RATE_1_S * c, -SWING_M * RATE_1_S * RATE_1_S * s


class Flight:
    """Three vehicles in formation, 3 m below the ceiling."""

    def __init__(self, folder: Path, kind: AutopilotKind) -> None:
        point = {"kind": "point", "point_enu_m": [0.0, 0.0, HEIGHT_M]}
        ceiling = f"fleet.envelope.fence_max_enu_m=[60, 60, {CEILING_M}]"
        overrides = (f"stand_in.autopilot={kind}", "stand_in.armable_after_s=1", ceiling)
        self.fleet = EnteringFleet(scenario_of(folder, SLOTS, SLOTS, point, *overrides))
        self.lockstep = self.fleet.lockstep
        assert self.fleet.accepted(CommandName.FORM)
        self.fleet.go_on(1.0)
        self.began_s = self.lockstep.now_s()

    def lie(self, liar: int) -> None:
        """From now on the packets of this vehicle, and what the others hear of the RFT by it, swing up and down."""
        send = self.lockstep.network.send

        def sent(packet: PeerPacket, now_s: float) -> None:
            if packet.sender.vehicle_id == liar:
                z, vz, az = swing(now_s - self.began_s)
                (x, y, _), (vx, vy, _) = packet.motion.position_enu_m, packet.motion.velocity_enu_m_s
                ax, ay, _ = packet.motion.acceleration_enu_m_s2
                rft = ((0.0, 0.0, z), (0.0, 0.0, vz), (0.0, 0.0, az)) if packet.rft else None
                packet = with_fields(
                    packet,
                    position_enu_m=(x, y, z),
                    velocity_enu_m_s=(vx, vy, vz),
                    acceleration_enu_m_s2=(ax, ay, az),
                    rft=rft,
                )
            send(packet, now_s)

        self.lockstep.network.send = sent  # type: ignore[method-assign]

    def lead(self) -> None:
        """From now on the leader's reference itself swings up and down, which no check has seen."""
        plan = self.lockstep.vehicles[LEADER].agent.guidance.references
        assert plan is not None
        begun: list[float] = []

        def at(reference_s: float) -> FormationState:
            begun.append(reference_s)
            z, vz, az = swing(reference_s - begun[0])
            return FormationState((0.0, 0.0, z), (0.0, 0.0, vz), (0.0, 0.0, az))

        plan.at = at  # type: ignore[method-assign]

    def check(self, moved: set[int]) -> None:
        """No vehicle leaves the room between floor and ceiling; these come to both."""
        self.fleet.go_on(LASTS_S)
        times_s = np.arange(self.began_s, self.lockstep.now_s() - 0.1, SAMPLE_S)
        for stand_in in self.lockstep.stand_ins:
            heights_m = stand_in.track().at(times_s)[:, 2]
            low_m, high_m = float(heights_m.min()), float(heights_m.max())
            assert low_m > FLOOR_M - OVERSHOOT_M
            assert high_m < CEILING_M - CLEARANCE_M + OVERSHOOT_M
            if stand_in.vehicle_id in moved:
                assert low_m < FLOOR_M + 1.0
                assert high_m > CEILING_M - CLEARANCE_M - 1.0
        assert self.fleet.phases() == {FlightPhase.FORMATION}, self.fleet.events
        assert self.fleet.smallest_m() > 1.9


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_followers_of_a_leader_that_claims_false_heights_stop_at_floor_and_ceiling(
    tmp_path: Path, kind: AutopilotKind
) -> None:
    flight = Flight(tmp_path, kind)
    flight.lie(LEADER)
    flight.check(moved={2, 3})


@pytest.mark.parametrize("kind", BOTH)
def test_a_follower_that_claims_false_heights_takes_none_beyond_floor_and_ceiling(
    tmp_path: Path, kind: AutopilotKind
) -> None:
    flight = Flight(tmp_path, kind)
    flight.lie(FOLLOWER)
    flight.check(moved=set())


@pytest.mark.parametrize("kind", BOTH)
def test_a_reference_beyond_floor_and_ceiling_takes_none_with_it(tmp_path: Path, kind: AutopilotKind) -> None:
    flight = Flight(tmp_path, kind)
    flight.lead()
    flight.check(moved={1, 2, 3})
