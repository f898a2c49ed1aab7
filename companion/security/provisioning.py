"""What `companion provision` does: new, renewed and revoked participants of a fleet.

All keys, certificates and the new list are made before anything is written. Then the folders in copy/ come first, the
authority's list second and its copies last. The same command completes a run that was killed in between.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from msgspec.structs import replace

from companion.config.atomic import PRIVATE, write_file
from companion.config.file import ConfigError
from companion.security.admission import (
    Admitted,
    AdmittedParticipant,
    RevokedParticipant,
    certificate_pem,
    key_der,
    key_pem,
    new_key,
    now_in_seconds,
    participant_certificate,
    serial_of,
)
from companion.security.fleet_folder import (
    FLEET_FILE,
    IDENTITY,
    FleetFiles,
    FleetFolder,
    read_fleet_files,
    write_configuration,
    write_mavlink_key,
)
from companion.security.identity import (
    ADMITTED_FILE,
    AUTHORITY_FILE,
    CERTIFICATE_FILE,
    KEY_FILE,
    PUBLIC_FOLDER,
    Authority,
    create_authority,
    make_folder,
    new_folder,
    one_at_a_time,
    open_authority,
    sign_list,
)
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name

COMMAND = "companion provision"


@dataclass(frozen=True, slots=True)
class Issued:
    """A new identity that is not written yet."""

    name: ParticipantName
    entry: AdmittedParticipant
    certificate: bytes
    key: bytes = field(repr=False)


def issue(authority: Authority, names: Sequence[ParticipantName], days: int, now: datetime) -> list[Issued]:
    """Keys and certificates. The authority's key is not read where there are none to make."""
    if not names:
        return []
    authority_key, issued = authority.key(), []
    for name in names:
        key = new_key()
        try:
            certificate = participant_certificate(
                name, key.public_key(), authority.certificate, authority_key, now, days
            )
        except ValueError as error:
            raise ConfigError(COMMAND, "--days", str(error)) from error
        entry = AdmittedParticipant(
            name=str(name),
            serial=serial_of(certificate),
            public_key=key_der(key.public_key()),
            expires_at=certificate.not_valid_after_utc,
        )
        issued.append(Issued(name, entry, certificate_pem(certificate), key_pem(key)))
    return issued


def merge_issued(admitted: Admitted, issued: Sequence[Issued]) -> tuple[AdmittedParticipant, ...]:
    """The participants with the new entries in place of those with the same names, and the others at the end."""
    entries = {one.name: one for one in admitted.participants} | {one.entry.name: one.entry for one in issued}
    return tuple(entries.values())


def next_list(
    authority: Authority,
    participants: tuple[AdmittedParticipant, ...],
    revoked: tuple[RevokedParticipant, ...],
    now: datetime,
) -> bytes:
    old = authority.admitted
    new = replace(old, number=old.number + 1, issued_at=now_in_seconds(now), participants=participants, revoked=revoked)
    return sign_list(authority, authority.key(), new)


@dataclass(frozen=True, slots=True)
class Provisioned:
    """The state after a run.

    `names` are the common names that were issued or revoked, `different` the files in copy/ that differ from those of the
    fleet and were not changed, `not_in_fleet` the admitted vehicles that the fleet file does not have. `removed` are the
    participants whose folder in copy/ was removed: `provision_new` leaves it so, `renew` has written it again.
    """

    folder: FleetFolder
    authority: Authority
    names: tuple[str, ...]
    different: tuple[Path, ...] = ()
    not_in_fleet: tuple[str, ...] = ()
    removed: tuple[ParticipantName, ...] = ()


def provision_new(
    folder: Path, wanted: Sequence[ParticipantName], default_ground: ParticipantName, days: int, now: datetime
) -> Provisioned:
    """Identities for the vehicles of the fleet file and the wanted participants that are not admitted yet.

    `default_ground` gets one where no ground is wanted or admitted. Raises ConfigError.
    """
    files, paths = read_fleet_files(folder), FleetFolder(folder)
    with one_at_a_time(folder):
        authority = _open_or_create(files, paths, now)
        names = _missing(files, wanted, default_ground, authority.admitted)
        if issued := issue(authority, names, days, now):
            data = next_list(authority, merge_issued(authority.admitted, issued), authority.admitted.revoked, now)
            with _tidy_after_failure(paths, now):
                _write_folders(paths, files, authority, issued)
                authority = _publish(paths, data, now)
        else:
            paths.distribute((paths.authority / ADMITTED_FILE).read_bytes())
        different = [path for name, copy in paths.copies() for path in write_configuration(copy, files.of(name))]
    vehicles = {f"{ParticipantRole.VEHICLE}-{vehicle_id}" for vehicle_id in files.vehicle_files}
    admitted = map(parse_common_name, authority.admitted.names(ParticipantRole.VEHICLE))
    gone = [str(name) for name in admitted if name.participant not in vehicles]
    removed = _find_removed(paths, map(parse_common_name, sorted(_participants(authority.admitted))))
    return Provisioned(paths, authority, _texts(issued), tuple(different), tuple(gone), removed)


def renew(folder: Path, names: Sequence[str] | None, days: int, now: datetime) -> Provisioned:
    """New keys and certificates under the same common names; None: for all that are admitted. Raises ConfigError."""
    paths = FleetFolder(folder)
    with one_at_a_time(folder):
        authority = _open(paths, now)
        chosen = _chosen(authority.admitted, names)
        removed = _find_removed(paths, chosen)
        files = read_fleet_files(folder) if removed else None
        issued = issue(authority, chosen, days, now)
        data = next_list(authority, merge_issued(authority.admitted, issued), authority.admitted.revoked, now)
        for one in issued:
            _renew_folder(paths, authority, one, now)
            if files and one.name in removed:
                write_configuration(paths.copy_of(one.name), files.of(one.name))
        authority = _publish(paths, data, now)
    return Provisioned(paths, authority, _texts(issued), removed=removed)


def revoke(folder: Path, names: Sequence[str], now: datetime) -> Provisioned:
    """Takes identities out of the list, for good. Raises ConfigError."""
    paths = FleetFolder(folder)
    with one_at_a_time(folder):
        authority = _open(paths, now)
        admitted = authority.admitted
        _check_revocable(admitted, names)
        chosen = set(map(str, _chosen(admitted, names)))
        kept = tuple(one for one in admitted.participants if one.name not in chosen)
        revoked = tuple(
            RevokedParticipant(name=one.name, serial=one.serial, revoked_at=now_in_seconds(now))
            for one in admitted.participants
            if one.name in chosen
        )
        authority = _publish(paths, next_list(authority, kept, (*admitted.revoked, *revoked), now), now)
    return Provisioned(paths, authority, tuple(one.name for one in revoked))


def open_provisioned(folder: Path) -> Authority:
    """The authority of a fleet that was provisioned. Raises ConfigError."""
    paths = FleetFolder(folder)
    if not paths.authority.is_dir():
        raise ConfigError(paths.authority, "", f"no such folder; {COMMAND} new {folder} creates it")
    return open_authority(paths.authority)


# ---------------------------------------------------------------- what is to be done


def _open(paths: FleetFolder, now: datetime) -> Authority:
    authority = open_provisioned(paths.folder)
    if now < authority.certificate.not_valid_before_utc:
        begin = f"{authority.certificate.not_valid_before_utc:%Y-%m-%d}"
        text = (
            f"the clock of this computer shows {now:%Y-%m-%d}, before the authority was made ({begin}); set the clock"
        )
        raise ConfigError(paths.authority, "", text)
    paths.tidy(_participants(authority.admitted), now)
    return authority


def _open_or_create(files: FleetFiles, paths: FleetFolder, now: datetime) -> Authority:
    if not paths.authority.exists():
        if paths.copy.exists():
            text = f"exists without {paths.authority}; restore that folder from its backup"
            raise ConfigError(paths.copy, "", f"{text}, or move copy away for a new authority")
        create_authority(paths.authority, files.fleet, now)
    authority = _open(paths, now)
    if authority.fleet != files.fleet:
        text = f'"{files.fleet}", but {paths.authority} is of fleet "{authority.fleet}"; a fleet keeps its name'
        raise ConfigError(paths.folder / FLEET_FILE, "name", f"{text}, or move authority and copy away")
    return authority


def _missing(
    files: FleetFiles, wanted: Sequence[ParticipantName], default_ground: ParticipantName, admitted: Admitted
) -> list[ParticipantName]:
    """The names to issue, in the generation that is next."""
    names = [ParticipantName(ParticipantRole.VEHICLE, str(vehicle_id)) for vehicle_id in files.vehicle_files]
    names += wanted
    if not admitted.names(ParticipantRole.GROUND) and all(name.role is not ParticipantRole.GROUND for name in names):
        names.append(default_ground)
    known = _participants(admitted)
    return [admitted.next_name(name) for name in dict.fromkeys(names) if name.participant not in known]


def _chosen(admitted: Admitted, names: Sequence[str] | None) -> list[ParticipantName]:
    """Admitted names by what the operator wrote: vehicle-3, or the whole common name vehicle-3.2."""
    parsed = [parse_common_name(one.name) for one in admitted.participants]
    if names is None and parsed:
        return parsed
    if names is None:
        raise ConfigError(COMMAND, "--all", "no participant is admitted; companion provision new DIR admits some")
    by_text = {text: name for name in parsed for text in (name.participant, str(name))}
    for text in names:
        if text not in by_text:
            hint = "companion provision list DIR shows the names"
            raise ConfigError(COMMAND, text, f"is not admitted; {hint}")
    return list(dict.fromkeys(by_text[text] for text in names))


def _check_revocable(admitted: Admitted, names: Sequence[str]) -> None:
    """The same command given twice must not revoke the identity that came after. Raises ConfigError."""
    for text in names:
        if was := admitted.revocation(text):
            name = parse_common_name(text)
            present = admitted.name_of(name.role, name.id)
            hint = (
                f"its present identity is {present}"
                if present
                else "companion provision new DIR makes its next identity"
            )
            raise ConfigError(COMMAND, text, f"is revoked since {was.revoked_at:%Y-%m-%d}; {hint}")


def _participants(admitted: Admitted) -> set[str]:
    return {parse_common_name(one.name).participant for one in admitted.participants}


def _find_removed(paths: FleetFolder, names: Iterable[ParticipantName]) -> tuple[ParticipantName, ...]:
    """Those without a key in copy/."""
    return tuple(name for name in names if not (paths.copy_of(name) / IDENTITY / KEY_FILE).exists())


def _texts(issued: Iterable[Issued]) -> tuple[str, ...]:
    return tuple(str(one.name) for one in issued)


# ---------------------------------------------------------------- written


@contextmanager
def _tidy_after_failure(paths: FleetFolder, now: datetime) -> Iterator[None]:
    """After an exception or Ctrl-C copy/ has the folders of those that are admitted, and no others."""
    try:
        yield
    except BaseException:
        with suppress(OSError, ConfigError):
            paths.tidy(_participants(open_authority(paths.authority).admitted), now)
        raise


def _write_folders(paths: FleetFolder, files: FleetFiles, authority: Authority, issued: Sequence[Issued]) -> None:
    if not paths.copy.exists():
        make_folder(paths.copy)
    for one in issued:
        with new_folder(paths.copy_of(one.name), PUBLIC_FOLDER) as part:
            make_folder(part / IDENTITY, PUBLIC_FOLDER)
            _write_identity(part / IDENTITY, authority, one)
            write_configuration(part, files.of(one.name))
            if one.name.role is ParticipantRole.VEHICLE:
                write_mavlink_key(part)


def _renew_folder(paths: FleetFolder, authority: Authority, one: Issued, now: datetime) -> None:
    """The old key and certificate go to retired/."""
    copy = paths.copy_of(one.name)
    if not paths.copy.exists():
        make_folder(paths.copy)
    if not copy.exists():
        make_folder(copy, PUBLIC_FOLDER)
    with new_folder(copy / IDENTITY, PUBLIC_FOLDER) as part:
        _write_identity(part, authority, one)
        write_file(part / ADMITTED_FILE, (paths.authority / ADMITTED_FILE).read_bytes())
        if (copy / IDENTITY).exists():
            paths.retire(copy / IDENTITY, str(one.name), now)


def _write_identity(folder: Path, authority: Authority, one: Issued) -> None:
    """Without a list: one that admits a new name follows when the authority has it."""
    write_file(folder / KEY_FILE, one.key, PRIVATE)
    write_file(folder / CERTIFICATE_FILE, one.certificate)
    write_file(folder / AUTHORITY_FILE, certificate_pem(authority.certificate))


def _publish(paths: FleetFolder, data: bytes, now: datetime) -> Authority:
    """Writes the list for the authority and into the copies of those that are admitted. Returns the authority with it."""
    write_file(paths.authority / ADMITTED_FILE, data)
    authority = open_authority(paths.authority)
    paths.tidy(_participants(authority.admitted), now)
    paths.distribute(data)
    return authority
