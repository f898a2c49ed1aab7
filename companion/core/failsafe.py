"""HealthFlags -> what to do while setpoints stream: a ranked table, nothing else.

SILENT is not an emergency brake: it lets the autopilot's own failsafe act (PX4 COM_OBL_RC_ACT, ArduPilot GUID_TIMEOUT).
"""

from __future__ import annotations

from collections.abc import Collection

from companion.types import FailsafeAction, HealthFlag

ACTIONS: dict[HealthFlag, FailsafeAction] = {
    HealthFlag.STATE_STALE: FailsafeAction.SILENT,
    HealthFlag.ATTITUDE_STALE: FailsafeAction.SILENT,
    HealthFlag.MODE_STALE: FailsafeAction.SILENT,
    HealthFlag.FRAME_UNKNOWN: FailsafeAction.SILENT,
    HealthFlag.ARMED_STALE: FailsafeAction.HOLD,
    HealthFlag.LANDED_STALE: FailsafeAction.HOLD,
    HealthFlag.LEADER_AWAITED: FailsafeAction.NONE,
    HealthFlag.LEADER_LOST: FailsafeAction.HOLD,
    HealthFlag.FENCE: FailsafeAction.HOLD,
    HealthFlag.FRAME_CONTRADICTED: FailsafeAction.HOLD,
    HealthFlag.POSITION_JUMPED: FailsafeAction.HOLD,
}


def failsafe_action(flags: Collection[HealthFlag]) -> FailsafeAction:
    """The highest-ranked action of all raised flags. It clears by itself when its flags do; a hold, once begun, is finished."""
    if not flags:
        return FailsafeAction.NONE
    return max([ACTIONS[flag] for flag in flags])
