"""A real agent process on a signed link: it flies with the right key and reports any other."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from common import until
from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, SigningKey, mavlink
from companion.types.commands import CommandName
from companion.types.notices import Code
from companion.types.status import Status
from processes import AgentFiles, agent, agent_files, companion
from wire_autopilots import LOITER, HoveringAutopilot

SECRET = bytes(range(1, 33))


def key(secret: bytes = SECRET, behind_s: float = 0.0) -> SigningKey:
    return SigningKey(secret, 0, lambda: time.time() - behind_s)


@pytest.fixture
def files(tmp_path: Path) -> AgentFiles:
    files = agent_files(tmp_path)
    (tmp_path / "mavlink.key").write_text(SECRET.hex() + "\n", encoding="ascii")
    (tmp_path / "mavlink.key").chmod(0o600)
    words = files.file.read_text(encoding="utf-8")
    files.file.write_text(words + "signing: {key_file: mavlink.key, link_id: 1}\n", encoding="utf-8")
    return files


def hold(files: AgentFiles, autopilot: HoveringAutopilot) -> Status:
    """Command HOLD until the agent reports it; its newest status."""
    with FleetSession("processtest", (files.zenoh,)) as session:
        until(lambda: getattr(session.command([1], CommandName.HOLD, 5.0)[1], "accepted", False))
        until(lambda: autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE))
        reports = session.drain()
        until(lambda: reports.extend(session.drain()) or reports)
        return reports[-1].status


def test_agent_and_autopilot_with_the_same_key_accept_each_other(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port, mode=(3, 0), key=key()) as autopilot, agent(files) as process:
        process.wait_for_log(f"udpin:127.0.0.1:{files.udp_port}, signed")
        status = hold(files, autopilot)
        until(lambda: autopilot.mode == LOITER)
        assert not {Code.MAVLINK_UNSIGNED, Code.MAVLINK_WRONG_KEY} & set(status.rejected)
        assert process.stop() == 0
    for secret in (SECRET.hex(), str(SECRET)):
        assert secret not in process.log


def test_foreign_packets_on_a_signed_link_are_counted_and_dropped(files: AgentFiles) -> None:
    stranger = MavlinkCodec(1, mavlink.MAV_COMP_ID_AUTOPILOT1)
    lie = mavlink.MAVLink_current_mode_message(0, 3 << 16, 3 << 16)
    with HoveringAutopilot(1, files.udp_port, key=key()) as autopilot, agent(files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        autopilot.inject(stranger.encode(lie))
        process.wait_for_log(Code.MAVLINK_UNSIGNED)
        replayed = MavlinkCodec(1, mavlink.MAV_COMP_ID_AUTOPILOT1, key(behind_s=30.0)).encode(
            lie
        )  # recorded half a minute ago
        for _ in range(5):
            autopilot.inject(replayed)
        process.wait_for_log(Code.MAVLINK_OLD_SIGNATURE)
        assert "timestamp" not in process.log  # one line of the agent, none per packet from pymavlink
        assert hold(files, autopilot).autopilot.mode_name == "AUTO.LOITER"


def test_an_autopilot_without_the_time_gets_it_from_the_agent(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port, key=key(behind_s=1e6)), agent(files) as process:
        process.wait_for_log("heartbeat of autopilot 1")


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (None, "its packets are not signed; give it the key"),
        (key(bytes(reversed(SECRET))), "its packets are signed with another key"),
    ],
    ids=["no key", "another key"],
)
def test_an_autopilot_with_another_key_or_none_is_never_accepted(
    files: AgentFiles, other: SigningKey | None, words: str
) -> None:
    with HoveringAutopilot(1, files.udp_port, key=other) as autopilot:
        result = companion("agent", "--config", str(files.file), "--wait-s", "1.5")
    assert result.returncode == 3
    assert words in result.stderr.splitlines()[-1]
    assert autopilot.received == []  # the agent has sent nothing to it


def test_an_agent_without_a_key_reports_that_the_autopilot_signs(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with HoveringAutopilot(1, files.udp_port, key=key()), agent(files) as process:
        process.wait_for_log("the autopilot signs its packets and may ignore unsigned ones: set signing")
