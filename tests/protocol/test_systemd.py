"""sd_notify messages as a service manager receives them."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from common import until
from companion.config.vehicle import load_agent
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.systemd import MIN_WATCHDOG_PERIOD_S, Notifier
from processes import WATCHDOG_S, AgentFiles, ServiceManager, agent, agent_files, service_manager
from wire_autopilots import HoveringAutopilot


@pytest.fixture
def files(tmp_path: Path) -> AgentFiles:
    return agent_files(tmp_path)


@pytest.mark.parametrize("name", ["path", "abstract"])
def test_an_agent_reports_ready_watchdog_and_stopping(files: AgentFiles, tmp_path: Path, name: str) -> None:
    address = str(tmp_path / "notify") if name == "path" else f"@companion-test-{os.getpid()}"
    with service_manager(address) as manager, agent(files, environment=manager.environment()) as process:
        manager.wait_for("WATCHDOG=1")  # it ticks
        assert "READY=1" not in manager.listen()  # but no autopilot is connected
        with HoveringAutopilot(1, files.udp_port):
            manager.wait_for("READY=1")
            manager.forget()
            started_s = time.monotonic()
            until(lambda: manager.listen().count("WATCHDOG=1") >= 5)
            assert manager.messages.count("WATCHDOG=1") <= 1 + (time.monotonic() - started_s) / MIN_WATCHDOG_PERIOD_S
            assert "READY=1" not in manager.messages  # sent once
            assert process.stop() == 0
        assert manager.listen()[-1] == "STOPPING=1"


def test_a_frozen_agent_does_not_feed_the_watchdog(files: AgentFiles, tmp_path: Path) -> None:
    with (
        service_manager(str(tmp_path / "notify")) as manager,
        HoveringAutopilot(1, files.udp_port),
        agent(files, environment=manager.environment()) as process,
    ):
        manager.wait_for("READY=1")
        manager.wait_for("WATCHDOG=1")
        process.process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        manager.forget()
        time.sleep(1.5 * WATCHDOG_S)  # systemd would restart it
        assert manager.listen() == []
        process.process.send_signal(signal.SIGCONT)
        manager.wait_for("WATCHDOG=1")


def test_an_agent_without_a_service_manager_runs(files: AgentFiles, tmp_path: Path) -> None:
    gone = str(tmp_path / "gone")
    with HoveringAutopilot(1, files.udp_port), agent(files, environment={"NOTIFY_SOCKET": gone}) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        assert process.stop() == 0
    assert "Traceback" not in process.log


# ---------------------------------------------------------------- notifier


def notifier(manager: ServiceManager, **environment: str) -> Notifier:
    return Notifier({"NOTIFY_SOCKET": manager.address, **environment})


@pytest.mark.parametrize(
    ("environment", "fed"),
    [
        ({}, 0),
        ({"WATCHDOG_USEC": "0"}, 0),
        ({"WATCHDOG_USEC": "soon"}, 0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, 0),  # for another process
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 20),  # every half second
        ({"WATCHDOG_USEC": "2000000"}, 20),
        ({"WATCHDOG_USEC": "100000"}, 50),  # limited to a few times a second
    ],
)
def test_the_watchdog_is_fed_a_few_times_per_its_period(tmp_path: Path, environment: dict[str, str], fed: int) -> None:
    with service_manager(str(tmp_path / "notify")) as manager:
        speaker = notifier(manager, **environment)
        for cycle in range(500):
            speaker.complete_cycle(cycle * 0.02, links_up=False)
            manager.listen()  # the kernel keeps ten messages, not more
        assert abs(manager.listen().count("WATCHDOG=1") - fed) <= 3
        speaker.close()


def test_without_cycles_the_watchdog_is_not_fed(tmp_path: Path) -> None:
    with service_manager(str(tmp_path / "notify")) as manager:
        speaker = notifier(manager, WATCHDOG_USEC="1000000")
        speaker.status("takeoff -> hold")
        time.sleep(0.6)
        assert manager.listen() == ["STATUS=takeoff -> hold"]
        speaker.close()


def test_ready_is_sent_again_until_it_is_received(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    speaker = Notifier({"NOTIFY_SOCKET": address})
    speaker.complete_cycle(0.0, links_up=True)  # no receiver yet
    with service_manager(address) as manager:
        speaker.complete_cycle(0.02, links_up=True)
        speaker.complete_cycle(0.04, links_up=True)
        assert manager.listen() == ["READY=1"]
    speaker.close()


def test_the_status_line_is_sent_when_it_changes(tmp_path: Path) -> None:
    with service_manager(str(tmp_path / "notify")) as manager:
        speaker = notifier(manager)
        for text in ("observe; no flags", "observe; no flags", "hold; MODE_STALE", "observe; no flags"):
            speaker.status(text)
        assert manager.listen() == ["STATUS=observe; no flags", "STATUS=hold; MODE_STALE", "STATUS=observe; no flags"]
        speaker.close()


def test_the_status_line_has_phase_and_flags(files: AgentFiles, tmp_path: Path) -> None:
    with (
        service_manager(str(tmp_path / "notify")) as manager,
        HoveringAutopilot(1, files.udp_port) as autopilot,
        agent(files, environment=manager.environment()),
    ):
        manager.wait_for("STATUS=observe; no flags")
        autopilot.positions = False
        manager.wait_for("STATUS=observe; POSITION_STALE")


def test_a_closed_session_is_no_fleet_link(files: AgentFiles) -> None:
    config = load_agent(files.file)
    link = ZenohLink(1, config.fleet, config.vehicle.zenoh, lambda _code: None)
    assert link.is_open  # without any peer
    link.close()
    assert not link.is_open
