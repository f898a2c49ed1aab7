"""Sends an admission list to the agents of a fleet, until each reports its number."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from companion.config.bounded_read import read_regular
from companion.ground.answers import AnswerKind
from companion.ground.sending import OperateError
from companion.ground.session import FleetSession
from companion.security.admission import MAX_LIST_BYTES, AdmissionError, verify
from companion.security.identity import Identity
from companion.types.status import Status

AGAIN_S = 1.0
ADMITTED_WITHIN_S = 10.0  # agents look for a list every 2 s


def admit(session: FleetSession, identity: Identity, file: Path, ids: Sequence[int]) -> tuple[list[str], bool]:
    """One line for each vehicle, and whether all hold the list. Raises OperateError for a file that is none."""
    try:
        data, _ = read_regular(file, MAX_LIST_BYTES)
        admitted = verify(data, identity.authority)
    except OSError as error:
        raise OperateError(f"{file}: cannot be read: {error.strerror}") from error
    except AdmissionError as error:
        raise OperateError(f"{file}: {error}") from error
    end_s = time.monotonic() + ADMITTED_WITHIN_S
    while time.monotonic() < end_s:
        session.send_admission_list(data)
        time.sleep(AGAIN_S)
        if all(_holds(session.newest().get(i), admitted.number) for i in ids):
            break
    statuses = session.newest()
    lines = [_line(i, statuses.get(i), admitted.number) for i in ids]
    return lines, all(_holds(statuses.get(i), admitted.number) for i in ids)


def _holds(status: Status | None, number: int) -> bool:
    return status is not None and status.network.admission is not None and status.network.admission >= number


def _line(vehicle_id: int, status: Status | None, number: int) -> str:
    if status is None:
        return f"vehicle {vehicle_id:<3} {AnswerKind.MISSING}  no report"
    held = status.network.admission
    kind = AnswerKind.ACCEPTED if _holds(status, number) else AnswerKind.MISSING
    return f"vehicle {vehicle_id:<3} {kind}  holds list {'none' if held is None else held}, sent was {number}"
