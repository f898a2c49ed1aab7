"""`companion agent`: the command of the onboard agent, and how it keeps OpenSSL out of its memory."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec

from companion.cli.options import add_vehicle_file
from companion.cli.program import command
from companion.types.errors import EXIT_DONE

BUILT_IN_SHA256 = ("_sha256", "_sha2")  # until Python 3.11, and since


def _run_agent(options: argparse.Namespace) -> int:
    """Run the agent of one vehicle. It reads telemetry from the autopilot over MAVLink and the states of
    the peers over Zenoh, and sends attitude and thrust setpoints at 50 Hz. It starts in phase observe
    and sends no setpoint before a command.

    examples:
      companion agent --config /etc/companion/vehicle-3.yaml --wait-s 60

    The vehicle file names the autopilot and the peers (examples: config/vehicles/ of the source tree):
      mavlink: udpin:0.0.0.0:14540             listen where the autopilot sends (PX4's onboard link)
      mavlink: tcp:192.168.1.20:5760           connect
      mavlink: serial:/dev/ttyAMA0:921600      a telemetry port of the flight controller
    The HEARTBEAT identifies PX4 or ArduCopter; `autopilot: px4` or `autopilot: ardupilot` in the
    vehicle file requires one of them.

    SIGTERM and SIGINT (Ctrl-C) end the agent. A vehicle in formation is first handed over to the
    autopilot's hold mode, for at most 2 s. Each event is one line on standard error.

    exit codes:
      0  ended by a signal
      2  a file, an endpoint in it or an argument cannot be used; standard error has the reason
      3  the autopilot never answered
      4  a defect: level attitude and the autopilot's hold mode were sent first; standard error has the reason
    """

    leave_out_openssl()
    try:
        from companion.app import Settings, run_agent

        run_agent(Settings(options.config, options.wait_s))
    except KeyboardInterrupt:  # the usual end, here before the agent handles signals itself
        pass
    return EXIT_DONE


def leave_out_openssl() -> None:
    """Makes `import ssl` and `import _hashlib` fail from now on, as on a system without OpenSSL: 5 MB of memory less.

    To be called before `asyncio` imports it for TLS and `hashlib` for hashes. `asyncio` then has no TLS, which no agent uses
    (Zenoh and `cryptography` carry their own), and `hashlib` takes the interpreter's own algorithms; an interpreter without
    them keeps those of OpenSSL.
    """
    left_out = ["ssl", "_ssl"]
    if any(map(find_spec, BUILT_IN_SHA256)) and find_spec("_blake2"):
        left_out.append("_hashlib")
    for name in left_out:
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]  # documented: an import of it then fails


AGENT = command("agent", "runs on each vehicle, beside its autopilot", add_vehicle_file, _run_agent)
