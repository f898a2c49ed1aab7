"""The systemd units, as systemd-analyze checks them and as the agent needs them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from common import ROOT
from companion.app import WAIT_FOR_AUTOPILOT_S
from companion.core.safety.safeguard import HAND_OVER_S
from companion.link.systemd import MIN_WATCHDOG_PERIOD_S

UNITS = sorted((ROOT / "deploy").glob("*.service"))
AGENT = ROOT / "deploy" / "companion@.service"
MOST_EXPOSED = 20  # tenths: 0 is best, 100 is no sandbox
needs_systemd = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not installed")


def names(units: list[Path]) -> list[str]:
    return [unit.name for unit in units]


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def settings(unit: Path, key: str) -> list[str]:
    lines = unit.read_text(encoding="utf-8").splitlines()
    return [line.partition("=")[2] for line in lines if line.startswith(key + "=")]


def setting(key: str) -> str:
    (value,) = settings(AGENT, key)
    return value


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=names(UNITS))
def test_a_unit_verifies(unit: Path, tmp_path: Path) -> None:
    instance = tmp_path / unit.name.replace("@.", "@3.")
    instance.write_bytes(unit.read_bytes())
    for path in (unit, instance):
        result = analyze("verify", str(path))
        assert (result.returncode, result.stderr) == (0, "")


@needs_systemd
@pytest.mark.parametrize(
    "change",
    [
        ("WatchdogSec=", "WatchdogSecs="),
        ("Type=notify", "Type=loud"),
        ("/usr/bin/env", "/no/such/binary"),
        ("identity.key:none", "identity.key:"),
    ],
)
def test_a_damaged_unit_does_not_verify(tmp_path: Path, change: tuple[str, str]) -> None:
    unit = tmp_path / "companion@3.service"
    unit.write_text(AGENT.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    result = analyze("verify", str(unit))
    assert result.returncode != 0 or result.stderr


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=names(UNITS))
def test_the_sandbox_scores_at_most_2(unit: Path) -> None:
    result = analyze("security", "--offline=true", f"--threshold={MOST_EXPOSED}", str(unit))
    assert result.returncode == 0, result.stdout[-300:]


@needs_systemd
def test_a_unit_without_its_sandbox_does_not_score(tmp_path: Path) -> None:
    unit = tmp_path / "companion@3.service"
    lines = AGENT.read_text(encoding="utf-8").splitlines()
    unit.write_text("\n".join(line for line in lines if not line.startswith(("Protect", "System"))), encoding="utf-8")
    assert analyze("security", "--offline=true", f"--threshold={MOST_EXPOSED}", str(unit)).returncode != 0


def test_the_agent_is_a_template_with_a_watchdog() -> None:
    assert setting("ExecStart") == "/usr/bin/env companion agent --config /etc/companion/vehicle-%i.yaml"
    assert setting("Type") == "notify"
    assert float(setting("WatchdogSec")) > 4 * MIN_WATCHDOG_PERIOD_S
    assert setting("WatchdogSignal") == "SIGKILL"  # a stopped process takes no other


def test_a_vehicle_in_the_air_gets_its_agent_back_every_time() -> None:
    assert setting("Restart") == "on-failure"
    assert setting("StartLimitIntervalSec") == "0"
    assert float(setting("RestartSec")) <= 0.5
    assert "network-online.target" not in setting("After")  # it may never come


def test_the_timeouts_leave_time_to_wait_and_hand_over() -> None:
    assert float(setting("TimeoutStartSec")) > WAIT_FOR_AUTOPILOT_S
    assert float(setting("TimeoutStopSec")) > HAND_OVER_S


def test_a_refused_system_call_is_an_error_and_no_kill() -> None:
    assert setting("SystemCallErrorNumber") == "EPERM"


@pytest.mark.parametrize("unit", UNITS, ids=names(UNITS))
def test_the_private_key_is_a_credential_that_may_be_missing(unit: Path) -> None:
    folder = "monitor" if "monitor" in unit.name else "identity"  # one computer may have both
    assert settings(unit, "LoadCredential") == [f"identity.key:/etc/companion/{folder}/private.key"]
    assert settings(unit, "SetCredential") == ["identity.key:none"]
    assert settings(unit, "User") == ["companion"]
