"""MAVLink 2 signing: what is signed, what is refused and why, and stamps that never go back."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.config.vehicle import Signing
from companion.config_file import ConfigError
from companion.link import signing_key
from companion.link.signing_key import read_signing_key
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.signing import EPOCH_UNIX_S, NOT_SIGNED, OLD_STAMP, UNITS_PER_S, WRONG_KEY, SigningKey

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


def test_a_packet_is_signed_as_the_protocol_has_it() -> None:
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


def test_two_that_have_the_key_hear_each_other_and_nothing_twice() -> None:
    ours, theirs = codec(1, Clock()), codec(7, Clock())
    packets = [theirs.encode(BEAT) for _ in range(3)]
    assert len(ours.decode(b"".join(packets))) == 3
    assert ours.decode(packets[1]) == []
    assert ours.refused == {OLD_STAMP: 1}


@pytest.mark.parametrize(
    ("packet", "reason"),
    [
        (MavlinkCodec(7, 1).encode(BEAT), NOT_SIGNED),
        (
            common.MAVLink(None, 7, 1).heartbeat_encode(2, 12, 0, 0, 4).pack(common.MAVLink(None, 7, 1), True),
            NOT_SIGNED,
        ),
        (codec(7, Clock(), bytes([9] * 32)).encode(BEAT), WRONG_KEY),
        (codec(7, Clock(NOW_S - 61.0)).encode(BEAT), OLD_STAMP),
    ],
    ids=["unsigned", "MAVLink 1", "another key", "a minute old"],
)
def test_what_is_not_signed_rightly_is_refused_with_its_reason(packet: bytes, reason: str) -> None:
    ours = codec(1, Clock())
    assert ours.decode(packet) == []
    assert ours.refused == {reason: 1}
    assert len(ours.decode(codec(7, Clock()).encode(BEAT))) == 1  # and the next good one is heard


def test_what_is_passed_on_is_what_was_not_refused_as_it_came() -> None:
    ours, good = codec(1, Clock()), codec(7, Clock()).encode(BEAT)
    ours.decode(MavlinkCodec(7, 1).encode(BEAT) + good)
    assert ours.packets == [good]
    ours.decode(b"")
    assert ours.packets == []


def test_a_changed_bit_anywhere_is_refused() -> None:
    packet = codec(7, Clock()).encode(BEAT)
    for at in range(len(packet)):
        ours = codec(1, Clock())
        changed = bytearray(packet)
        changed[at] ^= 1
        assert ours.decode(bytes(changed)) == []


def test_a_forged_packet_from_the_future_does_not_make_the_true_ones_old() -> None:
    ours, theirs = codec(1, Clock()), codec(7, Clock())
    assert len(ours.decode(theirs.encode(BEAT))) == 1
    ours.decode(codec(7, Clock(NOW_S + 1e6), bytes([9] * 32)).encode(BEAT))
    assert len(ours.decode(theirs.encode(BEAT))) == 1


def test_stamps_never_go_back_whatever_the_clock_does() -> None:
    clock = Clock()
    ours = codec(1, clock)
    first = stamp(ours.encode(BEAT))
    clock.now_s -= 3600.0
    stamps = [first, *(stamp(ours.encode(BEAT)) for _ in range(3))]
    assert stamps == [first, first + 1, first + 2, first + 3]
    clock.now_s = NOW_S + 1.0
    assert stamp(ours.encode(BEAT)) == first + UNITS_PER_S


def test_a_clock_that_lost_the_time_is_put_right_by_what_the_other_end_remembers() -> None:
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
def test_a_key_is_32_bytes_or_64_digits_beside_the_vehicle_file(tmp_path: Path, content: bytes) -> None:
    key_file(tmp_path, content)
    key = read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key", link_id=5))
    assert (key.secret, key.link_id) == (SECRET, 5)
    assert "secret" not in repr(key)


def test_a_key_may_be_a_credential_of_the_service(tmp_path: Path) -> None:
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
        (SECRET[:31], 0o600, "31 bytes that are no key; expected 32 bytes or 64 hexadecimal digits"),
        (SECRET.hex()[:32].encode(), 0o600, "32 bytes that are no key"),
        (SECRET.hex()[:63].encode(), 0o600, "63 bytes that are no key"),
        (b"", 0o600, "0 bytes that are no key"),
        (bytes(32), 0o600, "a key of zeros means no signing"),
    ],
)
def test_what_is_no_key_or_no_secret_is_refused_without_telling_it(
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


def test_a_missing_key_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file or directory; check the path"):
        read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key"))


def test_without_the_time_nothing_is_signed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key_file(tmp_path, SECRET)
    monkeypatch.setattr(signing_key.time, "time", Clock(86_400.0))
    monkeypatch.setattr(signing_key.time, "gmtime", lambda: (1970, 1, 2, 0, 0, 0, 0, 0, 0))
    with pytest.raises(ConfigError, match="clock says 1970-01-02; set it first"):
        read_signing_key(tmp_path / "vehicle.yaml", Signing(key_file="mavlink.key"))
