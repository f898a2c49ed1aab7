"""Tables of docs/protocol.md: timing constants, telemetry rates and flight modes, from the code that uses them."""

from __future__ import annotations

from companion.config.fleet import PeerLimits
from companion.core.election.leadership import TURN_S
from companion.core.safety.failsafe import limit_of
from companion.core.safety.safeguard import HAND_OVER_S
from companion.link.fleet.zenoh_session import LEASE_MS
from companion.link.tick import BACK_UP_S, PERIOD_S
from companion.mavlink import ardupilot, px4
from companion.mavlink.codec import mavlink
from companion.types.commands import EPOCHS_AHEAD, NUMBERS_AHEAD
from companion.types.notices import Code
from companion.wire.messages import WIRE_VERSION

C = Code


def timing() -> str:
    """One row for each constant that decides when something counts as late, lost or over."""
    peers = PeerLimits()
    rows = [
        ("wire version", f"{WIRE_VERSION}", "first byte of every message"),
        ("control period", f"{PERIOD_S * 1e3:g} ms", "one peer packet and one setpoint in each"),
        ("back-up tick", f"{BACK_UP_S * 1e3:g} ms", "longest time between two ticks without a position"),
        ("oldest own position", f"{limit_of(C.POSITION_STALE) * 1e3:g} ms", "older: no setpoint (`POSITION_STALE`)"),
        ("oldest own attitude", f"{limit_of(C.ATTITUDE_STALE) * 1e3:g} ms", "older: no setpoint (`ATTITUDE_STALE`)"),
        ("oldest flight mode", f"{limit_of(C.MODE_STALE) * 1e3:g} ms", "older: no setpoint (`MODE_STALE`)"),
        (
            "oldest armed and landed state",
            f"{limit_of(C.ARMED_STALE):g} s, {limit_of(C.LANDED_STALE):g} s",
            "older: hand over to hold",
        ),
        ("oldest peer state", f"{peers.max_age_s * 1e3:g} ms", "`peers.max_age_s`; older: not a neighbour"),
        (
            "oldest leader beacon",
            f"{peers.leader_beacon_max_age_s * 1e3:g} ms",
            "`peers.leader_beacon_max_age_s`; older: leader missed",
        ),
        ("turn of a successor", f"{TURN_S * 1e3:g} ms", "waited before the first claim and between claims"),
        (
            "silence that ends a formation",
            f"{limit_of(C.NO_SETPOINT) * 1e3:g} ms",
            "below PX4's `COM_OF_LOSS_T` of 1 s",
        ),
        ("hand-over at the end of the agent", f"{HAND_OVER_S:g} s", "then the process ends in any case"),
        (
            "epochs ahead, of peers",
            f"{EPOCHS_AHEAD}",
            "and one per second without a leader; a larger one claims nothing",
        ),
        ("numbers and epochs ahead, of commands", f"{NUMBERS_AHEAD}", "larger steps are refused"),
        ("Zenoh lease", f"{LEASE_MS / 1e3:g} s", "a silent connection is closed and opened again"),
    ]
    return _table(("what", "value", "meaning"), rows)


def telemetry() -> str:
    """One row for each MAVLink message whose rate the agent sets, with the interval for each autopilot."""
    ids = sorted(
        set(px4.STREAMS_US) | set(ardupilot.STREAMS_US), key=lambda number: mavlink.mavlink_map[number].msgname
    )
    rows = [
        (
            f"`{mavlink.mavlink_map[number].msgname}`",
            _interval(px4.STREAMS_US.get(number)),
            _interval(ardupilot.STREAMS_US.get(number)),
        )
        for number in ids
    ]
    return _table(("message", "PX4", "ArduCopter"), rows)


def modes() -> str:
    """One row for each flight mode by meaning, with each autopilot's own name."""
    rows = []
    for mode in px4.MODES:
        main, sub = px4.MODES[mode]
        _, px4_name = px4.mode_of(main << 16 | sub << 24)
        number = ardupilot.MODES.get(mode)
        rows.append((mode.name, px4_name, "GUIDED (NAV_TAKEOFF)" if number is None else ardupilot.mode_of(number)[1]))
    return _table(("meaning", "PX4", "ArduCopter"), rows)


def _interval(period_us: int | None) -> str:
    if period_us is None:
        return "not requested"
    return "off" if period_us < 0 else f"{1e6 / period_us:g} Hz"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
