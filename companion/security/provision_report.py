"""What `companion provision` prints: what was done, what is next, and the table of participants."""

from __future__ import annotations

from datetime import datetime, timedelta

from companion.security.admission import Admitted, AdmittedParticipant, day
from companion.security.fleet_folder import MAVLINK_KEY_FILE, FleetFolder
from companion.security.identity import ADMITTED_FILE, KEY_FILE, Authority
from companion.security.names import ParticipantRole, parse_common_name
from companion.security.provisioning import Provisioned

RENEW_WITHIN_DAYS = 30
SERIAL_DIGITS = 8
ETC = "/etc/companion"
WITHOUT_MAVLINK_KEY = ", without mavlink.key: the board and its autopilot keep theirs"
ROW = "{:<24} {:<9} {:<12} {:<10} {}"


def new_text(done: Provisioned) -> str:
    """What `companion provision new` prints."""
    admitted = done.authority.admitted
    lines = _heading(done, "new")
    if not done.names:
        lines.append("every participant is admitted already; nothing new")
    lines += [
        f"differs from the file of the fleet: {path}; remove it and run this again to have it written"
        for path in done.different
    ]
    lines += [
        f"admitted, but not in the fleet file: {name}; companion provision revoke {done.folder.folder} {name}"
        for name in done.not_in_fleet
    ]
    for name in done.removed:
        lines += [
            f"not in copy/: {name.participant}. Where its computer has its files nothing is to do; else, with a new key:",
            f"  companion provision renew {done.folder.folder} {name.participant}",
        ]
    if done.names:
        others = len(admitted.participants) > len(done.names)
        lines += ["next:", *_copy_steps(done), *(_list_step(done.folder, 2) if others else [])]
        lines += _backup_step(done.folder, 3 if others else 2)
    return "\n".join(lines) + "\n"


def renew_text(done: Provisioned) -> str:
    """What `companion provision renew` prints."""
    lines = _heading(done, "renewed")
    for name in done.removed:
        without = WITHOUT_MAVLINK_KEY if name.role is ParticipantRole.VEHICLE else ""
        lines.append(f"written again, because it was removed: {done.folder.copy_of(name)}{without}")
    lines += [f"the old keys and certificates are in {done.folder.retired}", "next:", *_copy_steps(done)]
    return "\n".join([*lines, *_list_step(done.folder, 2), *_backup_step(done.folder, 3)]) + "\n"


def revoke_text(done: Provisioned) -> str:
    """What `companion provision revoke` prints."""
    folder = done.folder.folder
    lines = [
        *_heading(done, "revoked"),
        "Participants refuse these names as soon as they have the new list.",
        "next:",
        *_list_step(done.folder, 1),
        *_backup_step(done.folder, 2),
        f"  3. A new identity for a vehicle of the fleet file: companion provision new {folder}",
    ]
    return "\n".join(lines) + "\n"


def list_text(authority: Authority, now: datetime) -> str:
    """What `companion provision list` prints: first the admitted, then the revoked."""
    admitted = authority.admitted
    lines = [
        f"fleet {authority.fleet}, admission list {admitted.number} of {admitted.issued_at:%Y-%m-%d %H:%M} UTC, "
        f"authority until {day(authority.certificate)}",
        ROW.format("name", "serial", "valid until", "days left", "state"),
        *(_admitted_row(one, now) for one in admitted.participants),
    ]
    for one in admitted.revoked:
        state = f"revoked {one.revoked_at:%Y-%m-%d}"
        lines.append(ROW.format(one.name, one.serial[:SERIAL_DIGITS], "-", "-", state))
    return "\n".join(lines) + "\n"


def _admitted_row(one: AdmittedParticipant, now: datetime) -> str:
    days = -((now - one.expires_at) // timedelta(days=1))  # a day that has begun counts
    state = "expired, renew" if one.expires_at < now else "admitted"
    if state == "admitted" and days < RENEW_WITHIN_DAYS:
        state = "admitted, renew soon"
    return ROW.format(one.name, one.serial[:SERIAL_DIGITS], f"{one.expires_at:%Y-%m-%d}", max(days, 0), state)


def _heading(done: Provisioned, what: str) -> list[str]:
    """The list, and the names that were issued, with the end of their validity, or revoked."""
    admitted = done.authority.admitted
    names = [f"  {what}: {_with_end(admitted, name)}" for name in done.names]
    return [f"fleet {done.authority.fleet}, admission list {admitted.number}", *names]


def _with_end(admitted: Admitted, name: str) -> str:
    entry = admitted.participant(name)
    return f"{name}, valid until {entry.expires_at:%Y-%m-%d}" if entry else name


def _copy_steps(done: Provisioned) -> list[str]:
    """The same commands as in docs/field-guide.md."""
    names = [parse_common_name(text) for text in done.names]
    vehicles = [name for name in names if name.role is ParticipantRole.VEHICLE]
    lines = ["  1. Copy each folder to its computer, over a link that you trust:"]
    lines += [f"     scp -r {done.folder.copy_of(name)} ADDRESS-OF-VEHICLE-{name.id}:" for name in vehicles]
    lines += [f"     {done.folder.copy_of(name)}" for name in names if name not in vehicles]
    if vehicles:
        lines.append(f"     and on each board: sudo cp -r vehicle-N/. {ETC}/")
        lines.append(
            f"     {MAVLINK_KEY_FILE} in it is used only with signing: {{key_file: {MAVLINK_KEY_FILE}}} in the vehicle file"
        )
    return lines


def _list_step(folder: FleetFolder, number: int) -> list[str]:
    file = folder.authority / ADMITTED_FILE
    return [
        f"  {number}. Give the new list to all that are provisioned already, over the network:",
        f"     companion fleet admit {file}",
        f"     or as a file on each computer: {ETC}/identity/{ADMITTED_FILE}",
    ]


def _backup_step(folder: FleetFolder, number: int) -> list[str]:
    return [
        f"  {number}. Back up {folder.authority}, offline: {KEY_FILE} in it admits participants, and cannot be replaced."
    ]
