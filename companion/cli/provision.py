"""`companion provision`: the command line of identities, from the first one to its revocation."""

from __future__ import annotations

import argparse
import getpass
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from companion.cli.options import whole_number
from companion.cli.program import command
from companion.types.errors import EXIT_DONE, UnusableError

if TYPE_CHECKING:
    from companion.security.names import ParticipantName

MAX_DAYS = 3650
DEFAULT_DAYS = 365

NEW = """\
Make the authority, once, and an identity for each vehicle of the fleet file and for each named
participant that has none. What exists stays as it is: run it again for a vehicle or a ground
station that was added later. Without a ground station, one is named after the login user.
"""
RENEW = """\
Make new keys and certificates under the same names, before the old ones expire. The old ones are
kept in DIR/retired. For a board that is lost, use revoke: a renewal leaves the old key usable.
"""
REVOKE = """\
Take identities out of the admission list, for good. The others refuse them as soon as they have
the new list. The next identity of vehicle-3 is named vehicle-3.2.
"""
LIST = "Show the participants with the end of their certificates, and those that were revoked."


def _add_provision(parser: argparse.ArgumentParser) -> None:
    raw, exit_codes = argparse.RawDescriptionHelpFormatter, PROVISION.more[PROVISION.more.index("exit codes:") :]
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION", title="actions")
    for name, (summary, description, add, _) in ACTIONS.items():
        one = actions.add_parser(name, help=summary, description=description, epilog=exit_codes, formatter_class=raw)
        one.add_argument("folder", type=Path, metavar="DIR", help="folder of the fleet file and the vehicle files")
        if add is not None:
            add(one)


def _run_provision(options: argparse.Namespace) -> int:
    """Make the identities with which the participants of a fleet know each other: vehicles, ground
    stations, monitors, targets, sources of traffic and motion-capture systems. An authority of the
    fleet signs a certificate for each, and the list of all that are admitted. DIR is the folder that companion init wrote.

    examples:
      companion init field --vehicles 3 --origin 47.3977 8.5456 488
      companion provision new field --ground anna ben --monitor tower
      companion provision list field
      companion provision renew field --all
      companion provision revoke field vehicle-3

    folders:
      DIR/authority       key of the authority (private.key), its certificate and the admission list;
                          stays here, with a backup
      DIR/copy/NAME       what goes to the computer of one participant
      DIR/retired         what copy/ held before a renewal or a revocation

    exit codes:
      0    done; the last lines are what to go on with
      2    an argument or a file cannot be used; the line names it
      130  ended by Ctrl-C; the same command completes what is missing
    """
    if options.folder.is_file():
        expected = "expected the folder of the fleet file and the vehicle files, which companion init writes"
        raise UnusableError(f"{options.folder}: is a file; {expected}")
    *_, run = ACTIONS[options.action]
    print(run(options), end="")
    return EXIT_DONE


def _add_new(parser: argparse.ArgumentParser) -> None:
    for option, words in (
        ("ground", "ground stations, which command"),
        ("monitor", "monitors, which only read"),
        ("target", "targets, which publish the target of this name"),
        ("traffic", "sources of traffic, which publish vehicles outside the fleet"),
        ("mocap", "motion-capture systems, which publish the poses of the vehicles"),
    ):
        parser.add_argument(f"--{option}", nargs="+", default=[], type=_id_of(option), metavar="NAME", help=words)
    _add_days(parser)


def _add_renew(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help="like vehicle-3 or ground-anna")
    parser.add_argument("--all", action="store_true", help="all that are admitted")
    _add_days(parser)


def _add_revoke(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="+", metavar="NAME", help="like vehicle-3 or ground-anna")


def _add_days(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--days",
        type=whole_number(1, MAX_DAYS, "days"),
        default=DEFAULT_DAYS,
        metavar="N",
        help=f"validity of the new certificates (default {DEFAULT_DAYS})",
    )


def _id_of(role: str) -> Callable[[str], ParticipantName]:
    """The type of an argument: the id of a participant with this role."""

    def read(text: str) -> ParticipantName:
        from companion.security.names import ParticipantRole, participant_name

        try:
            return participant_name(ParticipantRole(role), text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return read


def _new(options: argparse.Namespace) -> str:
    from companion.security.provision_report import new_text
    from companion.security.provisioning import provision_new

    wanted = [*options.ground, *options.monitor, *options.target, *options.traffic, *options.mocap]
    return new_text(provision_new(options.folder, wanted, _default_ground(), options.days, _now()))


def _renew(options: argparse.Namespace) -> str:
    from companion.config.file import ConfigError
    from companion.security.provision_report import renew_text
    from companion.security.provisioning import renew

    if options.all == bool(options.names):
        raise ConfigError("companion provision renew", "", "expected names, or --all for all that are admitted")
    return renew_text(renew(options.folder, None if options.all else options.names, options.days, _now()))


def _revoke(options: argparse.Namespace) -> str:
    from companion.security.provision_report import revoke_text
    from companion.security.provisioning import revoke

    return revoke_text(revoke(options.folder, options.names, _now()))


def _list(options: argparse.Namespace) -> str:
    from companion.security.provision_report import list_text
    from companion.security.provisioning import open_provisioned

    return list_text(open_provisioned(options.folder), _now())


AddOptions = Callable[[argparse.ArgumentParser], None]
ACTIONS: dict[str, tuple[str, str, AddOptions | None, Callable[[argparse.Namespace], str]]] = {
    "new": ("identities for the vehicles of the fleet file and for named participants", NEW, _add_new, _new),
    "renew": ("new keys and certificates under the same names", RENEW, _add_renew, _renew),
    "revoke": ("takes identities out of the admission list", REVOKE, _add_revoke, _revoke),
    "list": ("names, ends of validity and states", LIST, None, _list),
}


def _now() -> datetime:
    return datetime.now(UTC)


def _default_ground() -> ParticipantName:
    """Named after the login user, in the characters of a name."""
    from companion.security.names import ParticipantRole, participant_name

    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # no such user, as in some containers
        user = ""
    text = re.sub("[^a-z0-9_-]", "-", user.lower()).lstrip("_-")[:32]
    return participant_name(ParticipantRole.GROUND, text or "operator")


PROVISION = command(
    "provision", "makes, renews, lists and revokes the identities of a fleet", _add_provision, _run_provision
)
