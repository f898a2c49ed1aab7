"""`companion monitor` as a process: its URL, its end, and what it cannot use."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from common import until
from companion import GROUND_INSTALL
from companion.link.fleet.zenoh_session import open_session
from companion.wire.keys import status_key
from companion.wire.messages import WIRE_VERSION
from ground_fleet import LinkedVehicles, linked_vehicles
from live_site import get, monitor, snapshot
from processes import companion
from tests.bench.monitor_load import write_fleet


@pytest.fixture(scope="module")
def vehicles() -> Iterator[LinkedVehicles]:
    with linked_vehicles() as running:
        yield running


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_one_url_shows_the_fleet_and_ends(vehicles: LinkedVehicles, number: signal.Signals) -> None:
    with monitor("--connect", *vehicles.endpoints) as (process, url):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", url)
        until(lambda: len(snapshot(url)["vehicles"]) == 3)
        until(lambda: len(snapshot(url)["connected"]) == 3)
        process.send_signal(number)
        assert process.wait(10.0) == 0
        assert process.stdout
        assert process.stderr
        assert process.stdout.read() == process.stderr.read() == ""


def test_lost_vehicles_do_not_end_it_and_come_back() -> None:
    with linked_vehicles(1) as vehicles:
        endpoints = vehicles.endpoints
        process_and_url = monitor("--connect", *endpoints)
        process, url = process_and_url.__enter__()
        until(lambda: snapshot(url)["vehicles"])
    try:
        until(lambda: snapshot(url)["vehicles"][0]["silent"])
        assert [alarm["code"] for alarm in snapshot(url)["alarms"]] == ["SILENT"]
        until(lambda: any(endpoints[0] in str(line) for line in snapshot(url)["unreachable"]))
        assert process.poll() is None
    finally:
        process_and_url.__exit__(None, None, None)


def test_reports_of_another_version_are_an_event() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with open_session(listen=(endpoint,), connect=()) as session, monitor("--connect", endpoint) as (_, url):

        def told() -> list[str]:
            session.put(status_key("load", 1), bytes((WIRE_VERSION + 1,)) + b"of another release")
            return [event["text"] for event in json.loads(get(url, "/api/v1/history")[1])["events"]]

        until(told)
        (text,) = told()
        assert text.endswith("refused: message of another wire version; run the same release everywhere")


def test_with_control_the_token_of_the_url_commands(vehicles: LinkedVehicles, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    write_fleet(vehicles.load.fleet, file)
    with monitor("--connect", *vehicles.endpoints, "--fleet-file", str(file), "--control") as (_, printed):
        url, token = printed.split("#token=")
        assert len(token) == 32
        until(lambda: len(snapshot(url)["vehicles"]) == 3)
        body = json.dumps({"fleet": "load", "name": "hold", "vehicle_ids": [2]})
        headers = {"Content-Type": "application/json"}
        assert get(url, "/api/v1/commands", "POST", body, **headers)[0] == 403
        status, answer = get(url, "/api/v1/commands", "POST", body, **headers, **{"X-Companion-Token": token})
        assert (status, json.loads(answer)["answers"][0]["kind"]) == (200, "accepted")
        assert vehicles.received("hold") == [2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--listen", "nonsense"], "--listen 'nonsense': expected ADDRESS:PORT, like 127.0.0.1:8600"),
        (["--listen", "127.0.0.1:99999"], "expected ADDRESS:PORT"),
        (["--listen", "192.0.2.1:8600"], "this machine has no such address; expected one of its own"),
        (["--listen", "no.such.host.invalid:8600"], "unknown host; expected an address of this machine"),
        (
            ["--tiles", "nowhere"],
            "--tiles nowhere: no such folder or file; expected a folder with Z/X/Y.png, or an MBTiles file",
        ),
        (["--tiles", __file__], "file is not a database; expected a folder with Z/X/Y.png, or an MBTiles file"),
        (["--control"], "--control needs the fleet file: give --fleet-file, or save one: companion fleet use FILE"),
        (["--mavlink", "udpout:127.0.0.1:14550"], "--mavlink needs the fleet file"),
        (["--fleet-file", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--fleet", "a/b"], "expected the name in a fleet file"),
        (["--connect", "nonsense"], '--connect "nonsense": expected PROTOCOL/HOST:PORT'),
    ],
)
def test_what_cannot_be_used_is_one_line(arguments: list[str], words: str) -> None:
    result = companion("monitor", *arguments)
    assert (result.returncode, result.stdout) == (2, "")
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_port_in_use_is_one_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        result = companion("monitor", "--listen", f"127.0.0.1:{other.getsockname()[1]}")
    assert result.returncode == 2
    assert "the port is in use; choose another one, or port 0 for any free one" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_an_address_that_others_reach_is_announced() -> None:
    with monitor("--listen", "0.0.0.0:0") as (process, url):
        assert url.startswith(f"http://{socket.gethostname()}:")
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == 0
        assert process.stderr
        assert process.stderr.read().startswith("warning: all who reach 0.0.0.0 over the network can see this fleet")


def test_without_its_package_it_names_what_to_install(tmp_path: Path) -> None:
    code = (
        "import sys, importlib.util as u; find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'aiohttp' else find(name, *a)\n"
        "from companion.cli.main import main; sys.exit(main(['monitor']))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path
    )
    assert result.returncode == 2
    assert result.stderr == (
        f"companion monitor: the live page needs the package aiohttp: {GROUND_INSTALL}, or use --tui\n"
    )


def test_what_it_records_it_plays_again(vehicles: LinkedVehicles, tmp_path: Path) -> None:
    file, flight = tmp_path / "fleet.yaml", tmp_path / "flight"
    write_fleet(vehicles.load.fleet, file)
    arguments = ("--connect", *vehicles.endpoints, "--fleet-file", str(file), "--record", str(flight))
    with monitor(*arguments) as (process, url):
        until(lambda: len(snapshot(url)["vehicles"]) == 3)
        until(lambda: any(flight.glob("*.mcap")))
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == 0
    with monitor("--replay", str(flight)) as (process, url):
        until(lambda: len(snapshot(url)["vehicles"]) == 3)
        shown = snapshot(url)
        assert shown["replay"]["begin_s"] <= shown["time_s"] <= shown["replay"]["end_s"]  # type: ignore[call-overload]
        assert json.loads(get(url, "/api/v1/fleets/load")[1])["name"] == "load"
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == 0


def test_a_replay_takes_no_commands_and_needs_a_recording(tmp_path: Path) -> None:
    result = companion("monitor", "--replay", str(tmp_path))
    assert result.returncode == 2
    assert "--replay: " in result.stderr
    assert "no recordings here" in result.stderr
    result = companion("monitor", "--replay", str(tmp_path), "--control")
    assert "--control" in result.stderr
    assert result.returncode == 2
