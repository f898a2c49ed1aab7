"""Received Zenoh keys are input like any other: what is no key of its kind is refused, and nothing raises."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.wire.keys import (
    LONGEST_KEY,
    pairing_key,
    pairing_sender_of,
    pose_key,
    pose_source_of,
    reply_fleet_of,
    reply_key,
    target_key,
    target_of,
    traffic_key,
    traffic_of,
)

DECODERS = (target_of, traffic_of, pose_source_of, pairing_sender_of, reply_fleet_of)
PIECES = st.sampled_from(
    ("formation", "platoon", "traffic", "target", "reply", "pairing", "pose", "*", "**", "$*", "", "1", "\u0661")
)


def test_a_true_key_gives_its_parts() -> None:
    assert target_of(target_key("platoon", "walker")) == "walker"
    assert traffic_of(traffic_key("platoon", "main", "4b1805")) == ("main", "4b1805")
    assert pose_source_of(pose_key("platoon", "hall", 3)) == "hall"
    assert pairing_sender_of(pairing_key("platoon", 12, 3)) == 12
    assert reply_fleet_of(reply_key("platoon", 3)) == "platoon"


@pytest.mark.parametrize(
    "key",
    [
        "**",
        "*",
        "formation/**",
        "formation/*/traffic/*/*",
        "formation/platoon/*/main/4b1805",
        "formation/platoon/traffic/main/**",
        "formation/platoon/traffic/main",
        "formation/platoon/traffic/main/a/b",
        "formation/platoon/traffic//a",
        "formation/platoon/target/",
        "formation/platoon/target/\x1b[2J",
        "formation/platoon/pose/main/*",
        "formation/platoon/pairing/*/1",
        "formation/platoon/pairing/\u0662/1",
        "formation/platoon/pairing/1000/1",
        "formation/*/reply/1",
        "other/platoon/reply/1",
        "formation",
        "",
        "/",
        "a/" * 2048,
        "formation/platoon/target/" + "x" * LONGEST_KEY,
    ],
)
def test_what_is_no_key_of_its_kind_is_refused(key: str) -> None:
    assert [decode(key) for decode in DECODERS] == [None] * len(DECODERS)


@given(st.one_of(st.text(max_size=LONGEST_KEY + 10), st.lists(PIECES, max_size=8).map("/".join)))
@example("x/" * 4096)
def test_no_key_makes_a_decoder_fail_or_gives_a_wildcard(key: str) -> None:
    for decode in DECODERS:
        found = decode(key)
        for part in found if isinstance(found, tuple) else (found,):
            assert part is None or (str(part) and not set(str(part)) & set("*$/#?"))
