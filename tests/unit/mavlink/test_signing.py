"""MAVLink 2 signing: signatures, refusals with their reasons, monotonic timestamps, key files."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.config.file import ConfigError
from companion.config.vehicle import Signing
from companion.link.autopilot_link import read_signing_key
from companion.mavlink.codec import EPOCH_UNIX_S, UNITS_PER_S, MavlinkCodec, SigningKey, mavlink
from companion.types.notices import Code

NOW_S = 1_795_000_000.0
SECRET = bytes(range(32))
BEAT = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)


class Clock:
    def __init__(self, now_s: float = NOW_S) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def codec(system_id: int, clock: Clock, secret: bytes = SECRET) -> MavlinkCodec:
    return MavlinkCodec(system_id, 1, SigningKey(secret, 3, clock))


def stamp(packet: bytes) -> int:
    low, high = struct.unpack("<IH", packet[-12:-6])
    return int(low) + (int(high) << 32)


def test_packet_is_signed_by_the_protocol() -> None:
    packet = codec(1, Clock()).encode(BEAT)
    assert packet[2] & mavlink.MAVLINK_IFLAG_SIGNED
    assert packet[-13] == 3  # the link's id
    assert stamp(packet) == round((NOW_S - EPOCH_UNIX_S) * UNITS_PER_S)
    other = common.MAVLink(None)
    other.signing.secret_key = SECRET
    assert other.decode(bytearray(packet)).get_type() == "HEARTBEAT"
    other.signing.secret_key = bytes(reversed(SECRET))
    with pytest.raises(common.MAVError):
        other.decode(bytearray(packet))


def test_packet_is_accepted_once_with_the_same_key() -> None:
    ours, theirs = codec(1, Clock()), codec(7, Clock())
    packets = [theirs.encode(BEAT) for _ in range(3)]
    assert len(ours.decode(b"".join(packets))) == 3
    assert ours.decode(packets[1]) == []
    assert ours.refused == {Code.MAVLINK_OLD_SIGNATURE: 1}


@pytest.mark.parametrize(
    ("packet", "reason"),
    [
        (MavlinkCodec(7, 1).encode(BEAT), Code.MAVLINK_UNSIGNED),
        (
            common.MAVLink(None, 7, 1).heartbeat_encode(2, 12, 0, 0, 4).pack(common.MAVLink(None, 7, 1), True),
            Code.MAVLINK_UNSIGNED,
        ),
        (codec(7, Clock(), bytes([9] * 32)).encode(BEAT), Code.MAVLINK_WRONG_KEY),
        (codec(7, Clock(NOW_S - 61.0)).encode(BEAT), Code.MAVLINK_OLD_SIGNATURE),
    ],
    ids=["unsigned", "MAVLink 1", "another key", "a minute old"],
)
def test_wrong_signature_is_refused_with_its_reason(packet: bytes, reason: str) -> None:
    ours = codec(1, Clock())
    assert ours.decode(packet) == []
    assert ours.refused == {reason: 1}
    assert len(ours.decode(codec(7, Clock()).encode(BEAT))) == 1  # and the next valid one is received


def test_accepted_packets_are_forwarded_unchanged() -> None:
    ours, good = codec(1, Clock()), codec(7, Clock()).encode(BEAT)
    ours.decode(MavlinkCodec(7, 1).encode(BEAT) + good)
    assert [packet.data for packet in ours.packets] == [good]
    ours.decode(b"")
    assert ours.packets == []


def test_packet_with_one_changed_bit_is_refused() -> None:
    packet = codec(7, Clock()).encode(BEAT)
    for at in range(len(packet)):
        ours = codec(1, Clock())
        changed = bytearray(packet)
        changed[at] ^= 1
        assert ours.decode(bytes(changed)) == []


def test_forged_future_timestamp_does_not_age_valid_packets() -> None:
    ours, theirs = codec(1, Clock()), codec(7, Clock())
    assert len(ours.decode(theirs.encode(BEAT))) == 1
    ours.decode(codec(7, Clock(NOW_S + 1e6), bytes([9] * 32)).encode(BEAT))
    assert len(ours.decode(theirs.encode(BEAT))) == 1


def test_timestamps_never_decrease_when_the_clock_steps_back() -> None:
    clock = Clock()
    ours = codec(1, clock)
    first = stamp(ours.encode(BEAT))
    clock.now_s -= 3600.0
    stamps = [first, *(stamp(ours.encode(BEAT)) for _ in range(3))]
    assert stamps == [first, first + 1, first + 2, first + 3]
    clock.now_s = NOW_S + 1.0
    assert stamp(ours.encode(BEAT)) == first + UNITS_PER_S


def test_lost_clock_is_corrected_by_the_peer_timestamp() -> None:
    before, theirs = codec(1, Clock()), codec(7, Clock(NOW_S - 1e6))
    packets = [before.encode(BEAT) for _ in range(100)]
    assert len(theirs.decode(b"".join(packets))) == 100
    restarted = codec(1, Clock(NOW_S - 1e5))
    assert theirs.decode(restarted.encode(BEAT)) == []  # as old as its clock
    assert len(restarted.decode(theirs.encode(BEAT))) == 1
    assert len(theirs.decode(restarted.encode(BEAT))) == 1


# ---------------------------------------------------------------- where the key comes from


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "mavlink.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("content", [SECRET, SECRET.hex().encode(), SECRET.hex().upper().encode() + b"\n"])
def test_key_file_has_32_bytes_or_64_hex_digits(tmp_path: Path, content: bytes) -> None:
    key_file(tmp_path, content)
    key = read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key", link_id=5))
    assert (key.secret, key.link_id) == (SECRET, 5)
    assert "secret" not in repr(key)


def test_key_is_read_from_a_systemd_credential(tmp_path: Path) -> None:
    key_file(tmp_path, SECRET, 0o400)
    key = read_signing_key(
        Path("/etc/x.yaml"), Signing(credential="mavlink.key"), {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    )
    assert key.secret == SECRET
    with pytest.raises(ConfigError, match=r"LoadCredential=mavlink\.key:FILE"):
        read_signing_key(Path("/etc/x.yaml"), Signing(credential="mavlink.key"), {})


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        (SECRET, 0o644, "every user of this computer has access to the key; chmod 600"),
        (SECRET[:31], 0o600, "31 bytes that are not a key; expected 32 bytes or 64 hexadecimal digits"),
        (SECRET.hex()[:32].encode(), 0o600, "32 bytes that are not a key"),
        (SECRET.hex()[:63].encode(), 0o600, "63 bytes that are not a key"),
        (b"", 0o600, "0 bytes that are not a key"),
        (bytes(32), 0o600, "a key of zeros means no signing"),
    ],
)
def test_invalid_key_file_is_refused_without_printing_the_key(
    tmp_path: Path, content: bytes, mode: int, words: str
) -> None:
    path = key_file(tmp_path, content, mode)
    with pytest.raises(ConfigError) as refusal:
        read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key"))
    line = str(refusal.value)
    assert line.startswith(f"{tmp_path / 'vehicle.yaml'}: signing.key_file: {path}: ")
    assert words in line
    assert "\n" not in line
    assert not content or content.hex() not in line
    assert SECRET.hex()[:16] not in line


def test_missing_key_file_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file or directory; check the path"):
        read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key"))


def test_signing_is_refused_when_the_clock_is_not_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key_file(tmp_path, SECRET)
    monkeypatch.setattr(time, "time", Clock(86_400.0))
    monkeypatch.setattr(time, "gmtime", lambda: (1970, 1, 2, 0, 0, 0, 0, 0, 0))
    with pytest.raises(ConfigError, match="clock shows 1970-01-02; set it first"):
        read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key"))
