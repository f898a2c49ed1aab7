"""The agent of a vehicle that lies: the real program, whose states are altered before they are encoded and signed.

Usage: lying_agent.py --config VEHICLE.yaml. The lies are those of `lies.json` beside the file, as soon as it is there.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import msgspec

from companion.cli.main import main
from companion.link.fleet import peer_states
from companion.types.peers import PeerPacket
from sitl.vehicle.lies import Liars, Lie

LIES = "lies.json"


class LyingEncoder:
    """Encodes what the lies of a file make of a packet. Their times count from when the file was last written."""

    def __init__(self, file: Path) -> None:
        self._encode, self._file = peer_states.encode_peer, file
        self._written_s, self._liars, self._since_s = 0.0, Liars(()), 0.0

    def __call__(self, packet: PeerPacket) -> bytes:
        written_s = self._file.stat().st_mtime if self._file.exists() else 0.0
        if written_s != self._written_s:
            lies = msgspec.json.decode(self._file.read_bytes(), type=tuple[Lie, ...])
            self._written_s, self._liars, self._since_s = written_s, Liars(lies), time.monotonic()
        return self._encode(self._liars.stated(packet, time.monotonic() - self._since_s))


def lie(folder: Path, *lies: Lie) -> None:
    """From now on the agents of this folder lie like this."""
    whole = folder / f"{LIES}.part"
    whole.write_bytes(msgspec.json.encode(lies))
    whole.replace(folder / LIES)


if __name__ == "__main__":
    peer_states.encode_peer = LyingEncoder(Path(sys.argv[2]).with_name(LIES))
    sys.exit(main(["agent", *sys.argv[1:]]))
