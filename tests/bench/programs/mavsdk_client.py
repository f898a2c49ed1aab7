"""A client as fast as mavsdk allows: set_attitude in the callback of every position.

python -m tests.bench.programs.mavsdk_client PORT
"""

from __future__ import annotations

import signal
import sys
import threading
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.logging import log_subscribe
from mavsdk.plugins.offboard.offboard import Attitude, Offboard
from mavsdk.plugins.telemetry.telemetry import Telemetry

from companion.link.tick import PERIOD_S
from sitl.links.ports import LOOPBACK

FOUND_WITHIN_S = 20.0


def main() -> None:
    """Until SIGTERM."""
    done = threading.Event()
    signal.signal(signal.SIGTERM, lambda _number, _frame: done.set())
    log_subscribe(lambda *_: True)  # no log lines
    client = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
    client.add_any_connection(f"udpin://{LOOPBACK}:{sys.argv[1]}")
    system = client.first_autopilot(FOUND_WITHIN_S)
    if system is None:
        raise SystemExit(f"no autopilot within {FOUND_WITHIN_S:g} s")
    telemetry, offboard = Telemetry(system), Offboard(system)
    attitude = Attitude(0.0, 0.0, 0.0, 0.5)

    def on_position(_position: Any, _user_data: Any) -> None:
        offboard.set_attitude(attitude)

    telemetry.set_rate_position_velocity_ned(1.0 / PERIOD_S)
    telemetry.subscribe_position_velocity_ned(on_position)
    done.wait()
    client.destroy()


if __name__ == "__main__":
    main()
