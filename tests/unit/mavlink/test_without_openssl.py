"""An agent does without OpenSSL, and its hashes and signatures are the same as with it."""

from __future__ import annotations

import subprocess
import sys

from companion.mavlink.codec import MavlinkCodec, SigningKey

PROGRAM = """
from companion.cli.main import main

assert main(["agent", "--config", "/no/such/vehicle.yaml"]) == 2

from pathlib import Path

import companion.app, companion.recording.recorder
from companion.link.fleet.peer_datagrams import DatagramSeal
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.codec import SigningKey

assert DatagramSeal(1, [1, 2]).own_keys
assert "libcrypto" not in Path("/proc/self/maps").read_text()
codec = MavlinkCodec(1, 1, SigningKey(bytes(32), 1, lambda: 1.8e9))
print(codec.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)).hex())
"""


def test_an_agent_signs_without_openssl() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True, timeout=60)
    receiver = MavlinkCodec(2, 1, SigningKey(bytes(32), 1, lambda: 1.8e9))
    (message,) = receiver.decode(bytes.fromhex(done.stdout))
    assert message.get_type() == "HEARTBEAT" and not receiver.refused
