"""A real agent that starts in the air while heights count from the take-off: with what the one before kept, and without."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from common import until
from companion.ground.reports import status_as_data, status_lines
from companion.ground.session import FleetSession
from companion.mavlink.codec import mavlink
from companion.types.commands import CommandName
from companion.types.flight import FLAG_TEXTS, FlightPhase, HealthFlag, Role
from companion.types.status import Status
from processes import AgentFiles, agent, agent_files
from wire_autopilots import PX4, HoveringAutopilot, TappedFlight, in_the_air


def counts_from_the_takeoff(files: AgentFiles, folder: Path) -> tuple[Path, dict[str, str]]:
    """The file that its agents keep, and their environment."""
    with (files.file.parent / "fleet.yaml").open("a", encoding="utf-8") as text:
        text.write("altitude_source: takeoff\n")
    state = folder / "state"
    state.mkdir()
    return state / "takeoff_1.json", {"STATE_DIRECTORY": str(state)}


def assert_says_that_it_must_land(status: Status) -> None:
    assert HealthFlag.GROUND_UNKNOWN in status.safety.flags
    assert (status.phase, status.leadership.role) == (FlightPhase.OBSERVE, Role.FOLLOWER)
    assert not status.motion.is_known
    (data,) = status_as_data({1: status}, ())
    assert (data["position_enu_m"], data["velocity_enu_m_s"]) == (None, None)
    text = "\n".join(status_lines({1: status}, (), 1.0))
    assert "position unknown" in text
    assert "0.0, 0.0" not in text


def test_without_what_was_kept_it_says_at_once_that_it_must_land_and_does_not_lead(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    kept, environment = counts_from_the_takeoff(files, tmp_path)
    kept.write_text('{"vehicle_id": 1, "ground_up_m": ', encoding="utf-8")
    with (
        HoveringAutopilot(1, files.udp_port) as autopilot,
        agent(files, environment=environment) as process,
        FleetSession("processtest", (files.zenoh,)) as session,
    ):
        seen: list[Status] = []

        def knows_its_autopilot() -> bool:
            seen.extend(report.status for report in session.drain())
            return bool(seen) and seen[-1].autopilot.armed and HealthFlag.GROUND_UNKNOWN in seen[-1].safety.flags

        until(knows_its_autopilot)
        process.wait_for_log(FLAG_TEXTS[HealthFlag.GROUND_UNKNOWN])
        assert_says_that_it_must_land(seen[-1])
        assert not any(status.autopilot.armed and status.leadership.role is Role.LEADER for status in seen)
        reply = session.command([1], CommandName.FORM, 5.0)[1]
        assert reply is not None
        assert not reply.accepted
        assert autopilot.target_times_s == []
        assert not autopilot.commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    assert process.log.count(str(kept)) == 1
    assert "takeoff_1.json: is not what an agent keeps of a take-off: input data was truncated; ignored" in process.log


def next_status(flight: TappedFlight, flags: set[HealthFlag]) -> Status:
    """The first one of a new agent that knows its autopilot, and then raises all of these flags, or has a position."""
    flight.forget_reports()

    def settled() -> Status | None:
        status = flight.status if flight.phase is not None else None
        if status is None or not status.autopilot.armed:
            return None
        assert status.leadership.role is Role.FOLLOWER or status.motion.is_known
        done = flags <= set(status.safety.flags) if flags else status.motion.is_known and not status.safety.flags
        return status if done else None

    until(settled)
    status = settled()
    assert status is not None
    return status


@pytest.mark.long
def test_it_has_the_position_of_the_one_before_and_without_it_lands(tmp_path: Path) -> None:
    with in_the_air(tmp_path, PX4) as flight:
        kept, environment = counts_from_the_takeoff(flight.files, tmp_path)
        with agent(flight.files, environment=environment) as first:
            flight.order(CommandName.PREPARE, FlightPhase.READY)
            flight.order(CommandName.ARM, FlightPhase.ARMED)
            flight.order(CommandName.TAKEOFF, FlightPhase.HOLD)
            until(kept.exists)
            before = flight.status
            assert before is not None
            first.stop(signal.SIGKILL)
        commands = len(flight.tap.commands)
        with agent(flight.files, environment=environment) as second:
            after = next_status(flight, set())
            assert after.motion.position_enu_m == pytest.approx(before.motion.position_enu_m, abs=0.5)
            assert "started again in the air: z counts from its take-off" in second.log
            flight.observes_and_sends_nothing(1.0)
            second.stop(signal.SIGKILL)
        kept.unlink()
        with agent(flight.files, environment=environment) as third:
            assert_says_that_it_must_land(next_status(flight, {HealthFlag.GROUND_UNKNOWN}))
            assert FLAG_TEXTS[HealthFlag.GROUND_UNKNOWN] in third.log
            assert len(flight.tap.commands) == commands  # neither armed again nor changed the mode
            flight.order(CommandName.LAND, FlightPhase.LAND)
            flight.stand_in.wait_until_disarmed()
            until(lambda: flight.phase and flight.status and not flight.status.autopilot.armed)
            until(lambda: flight.phase and flight.status and flight.status.motion.is_known, 10.0)
            assert flight.status is not None
            assert flight.status.motion.position_enu_m[2] == pytest.approx(0.0, abs=0.3)
            assert flight.status.leadership.role is Role.LEADER  # by its file, as on every ground
            assert not kept.exists()
