"""The steps of the boot with an agent: start, faults, formation, credentials, clean stop."""

from __future__ import annotations

import json
import time

from deploy.boot.documented import PAGE, guide_commands, missing_lines
from deploy.boot.machine import Machine, until
from deploy.boot.report import Results
from deploy.boot.service import UNIT, Service

FIELD, ENDPOINT = "/root/field", "tls/127.0.0.1:7447"
PREPARE = (
    f"companion init {FIELD} --vehicles 2 --origin 47.397742 8.545594 488 --mavlink udpin:127.0.0.1:14540"
    " --address 127.0.0.1:7447 127.0.0.1:7448",
    f"companion provision new {FIELD} --ground anna --monitor tower",
    f"cp -r {FIELD}/copy/vehicle-1/. /etc/companion/",
)
GROUND = ("--connect", ENDPOINT, "--identity", f"{FIELD}/copy/ground-anna/identity")
MONITOR_FILE = f"COMPANION_CONNECT={ENDPOINT}\nCOMPANION_IDENTITY=/etc/companion/monitor\n"
AUTOPILOT = ("systemd-run", "--unit=autopilot", "--quiet", "--slice=autopilot", "/opt/companion/bin/sitl", "autopilot")
DOCTOR = ("companion", "doctor", "--config", "/etc/companion/vehicle-1.yaml", "--fix")
DOCTOR_WITHIN_S = 90.0  # the stand-in's estimator needs some seconds
HOLD_MODE = "AUTO.LOITER"  # of PX4
KEY = "/etc/companion/identity/private.key"
CREDENTIAL = f"/run/credentials/{UNIT}/identity.key"
HUNG_READY_LIMIT_S = 5.0  # READY also waits for a HEARTBEAT, which comes once a second
STOP_LIMIT_S, KILLED_LIMIT_S, HUNG_LIMIT_S, START_LIMIT_S = 5.0, 3.0, 4.0, 5.0
MOST_COMMANDS = 10
TRIES, PAUSE_S, TOO_BUSY = 6, 5.0, "TICK_LATE"
WATCHDOG_LINE = "Watchdog timeout"


def start(machine: Machine, results: Results) -> Service:
    """From the installed package to READY, by the commands of the guide."""
    commands = guide_commands(PAGE.read_text(encoding="utf-8"))
    results.check("commands of the guide to READY", len(commands) < MOST_COMMANDS, str(len(commands)), "fewer than 10")
    findings = machine.run("companion", "doctor", "--host").stdout.strip().rpartition("\n")[2]
    results.check("companion doctor --host", " ok" in findings, findings, "a summary")
    for command in PREPARE:
        machine.must(*command.split())
    machine.must(*AUTOPILOT, "--id", "1")
    until(lambda: machine.run(*DOCTOR).returncode == 0, DOCTOR_WITHIN_S)
    results.check("companion doctor --fix", True, "fit to fly in formation", "fit to fly in formation")
    service = Service(machine)
    before_s = time.monotonic()
    machine.must("systemctl", "enable", "--now", UNIT)
    _, ready_s = service.back_after(before_s)
    results.time("systemctl enable --now to READY", ready_s, START_LIMIT_S)
    user = machine.must("stat", "--format=%U", f"/proc/{service.pid}").strip()
    results.check("the agent runs as its own user", user == "companion", user, "companion")
    _status_follows(machine, service, results)
    return service


def _status_follows(machine: Machine, service: Service, results: Results) -> None:
    until(lambda: service.status.endswith("no flags"), 30.0)
    shown = machine.run("systemctl", "status", "--no-pager", UNIT).stdout
    line = next((line.strip() for line in shown.splitlines() if "Status:" in line), "")
    results.check(
        "phase and flags in systemctl status", "observe; no flags" in line, line, 'Status: "observe; no flags"'
    )


def monitor(machine: Machine, results: Results) -> None:
    """The monitor's service records the vehicle in a journal of its own."""
    machine.must("cp", "-r", f"{FIELD}/copy/monitor-tower/identity", "/etc/companion/monitor")
    machine.run("sh", "-c", "cat >/etc/companion/monitor.env", stdin=MONITOR_FILE)
    machine.must("systemctl", "start", "companion-monitor")
    read = ("journalctl", "--namespace=companion-monitor", "--output=cat", "--no-pager")
    until(lambda: '"vehicle_id":1' in machine.run(*read).stdout, 20.0)
    machine.must("systemctl", "stop", "companion-monitor")
    ended = Service(machine, "companion-monitor.service").value("Result")
    results.check("companion-monitor records the vehicle", ended == "success", f"ended with {ended}", "success")


def killed_and_hung(service: Service, results: Results, where: str) -> None:
    """kill -9, then a process that no longer runs: both are back in phase observe."""
    _, ready_s = service.back_after(service.signal("KILL"))
    results.time(f"kill -9 to READY, {where}", ready_s, KILLED_LIMIT_S)
    _observes(service, results, f"after kill -9, {where}")
    lines = service.journal().count(WATCHDOG_LINE)
    restarted_s, ready_s = service.back_after(service.signal("STOP"))
    results.time(f"hung (SIGSTOP) to restarted, {where}", restarted_s, HUNG_LIMIT_S)
    results.time(f"hung (SIGSTOP) to READY, {where}", ready_s, HUNG_READY_LIMIT_S)
    watchdogs = service.journal().count(WATCHDOG_LINE) - lines
    results.check(f"the watchdog ended it, {where}", watchdogs == 1, f"{watchdogs} watchdog timeouts", "1")
    _observes(service, results, f"after the watchdog, {where}")


def _observes(service: Service, results: Results, when: str) -> None:
    until(lambda: service.phase, 5.0)
    results.check(f"phase {when}", service.phase == "observe", service.status, "observe")


def into_formation(machine: Machine, service: Service) -> None:
    """The leader alone into formation, from the ground; it lands first where it flies."""
    if report(machine)["armed"]:
        _command(machine, "land")
    for action, phase in (("arm", "armed"), ("takeoff", "hold"), ("form", "formation")):
        _command(machine, action)
        service.wait_phase(phase)


def land(machine: Machine, results: Results) -> None:
    """By command, after the agent was started again in the air."""
    _command(machine, "land")
    row = report(machine)
    found = f"{row['phase']}, {'armed' if row['armed'] else 'disarmed'}"
    results.check("land by command after the restarts in flight", not row["armed"], found, "disarmed")


def _command(machine: Machine, action: str) -> None:
    """Give a command to vehicle 1 and wait until it has finished. Raises BootError.

    Where the computer was busy the agent refuses to form (TICK_LATE); an operator tries again.
    """
    command = (
        "companion",
        "fleet",
        action,
        "--fleet",
        f"{FIELD}/fleet.yaml",
        *GROUND,
        "--only",
        "1",
        "--timeout",
        "60",
    )
    for _ in range(TRIES - 1):
        done = machine.run(*command)
        if done.returncode == 0:
            return
        if TOO_BUSY not in done.stdout:
            break
        print(f"--    {action} is refused, the computer is busy ({TOO_BUSY}); again in {PAUSE_S:g} s", flush=True)
        time.sleep(PAUSE_S)
    machine.must(*command)


def report(machine: Machine) -> dict[str, object]:
    """The newest status of vehicle 1, as the monitor prints it."""
    (row,) = json.loads(machine.must("companion", "monitor", "--once", "--json", *GROUND))
    assert isinstance(row, dict)
    return row


def credentials(machine: Machine, results: Results) -> None:
    """The private key reaches the agent, and no other user can read it."""
    seen = machine.run("runuser", "-u", "companion", "--", "cat", CREDENTIAL).stdout
    results.check("the agent's user reads the credential", "PRIVATE KEY" in seen, f"{len(seen)} bytes", "the key")
    for user in ("nobody", "companion"):
        refused = machine.run("runuser", "-u", user, "--", "cat", KEY)
        results.check(
            f"user {user} cannot read the key file", refused.returncode != 0, _last(refused.stderr), "refused"
        )
    refused = machine.run("runuser", "-u", "nobody", "--", "cat", CREDENTIAL)
    results.check("user nobody cannot read the credential", refused.returncode != 0, _last(refused.stderr), "refused")


def clean_stop(machine: Machine, service: Service, results: Results) -> None:
    """systemctl stop, in formation: the vehicle is in its autopilot's hold mode when the agent has ended."""
    before_s = time.monotonic()
    machine.must("systemctl", "stop", UNIT)
    results.time("systemctl stop in formation", time.monotonic() - before_s, STOP_LIMIT_S)
    ended = f"{service.value('Result')}, exit code {service.value('ExecMainStatus')}"
    results.check("its end", ended == "success, exit code 0", ended, "success, exit code 0")
    machine.must("systemctl", "start", UNIT)
    until(lambda: service.phase == "observe", 10.0)
    mode = str(report(machine)["mode_name"])
    results.check("the autopilot's mode afterwards", mode == HOLD_MODE, mode, HOLD_MODE)


def journal(service: Service, results: Results) -> None:
    """Every line that the guide documents has been in the journal."""
    missing = missing_lines(PAGE.read_text(encoding="utf-8"), service.journal())
    results.check("documented journal lines", not missing, f"missing: {missing}" if missing else "all", "all")


def _last(text: str) -> str:
    return text.strip().rpartition(": ")[2]
