"""Limits of epochs in packets and commands."""

from __future__ import annotations

import pytest

from companion.core.election.epoch_limits import COMMANDED_AHEAD, COMMANDED_WITHIN_S, RECEIVED_AHEAD, EpochLimits
from companion.types.commands import MAX_EPOCHS_AHEAD


def led_at(now_s: float) -> EpochLimits:
    limits = EpochLimits()
    limits.led(now_s)
    return limits


def test_who_has_never_known_a_leader_accepts_all_that_it_may_have_missed() -> None:
    assert EpochLimits().of_packets(0.0, 3) == EpochLimits().of_command(0.0, 3) == 3 + MAX_EPOCHS_AHEAD


def test_missed_time_allows_more() -> None:
    assert led_at(10.0).of_packets(10.0, 5) == 5 + RECEIVED_AHEAD
    assert led_at(10.0).of_packets(14.5, 5) == 5 + RECEIVED_AHEAD + 4


@pytest.mark.parametrize("missed_s", [0.0, 1.0, 30.0])
def test_peers_accept_what_repeated_commands_make_of_an_epoch(missed_s: float) -> None:
    """Of a vehicle that obeys every command while its peers receive none of its packets for `missed_s`."""
    commanded, peer, epoch = led_at(0.0), led_at(0.0), 0
    for tick in range(round(50 * missed_s) + 1):
        now_s = tick / 50
        commanded.led(now_s)
        epoch = max(epoch, commanded.of_command(now_s, epoch))
    assert epoch >= COMMANDED_AHEAD * (1 + missed_s // (COMMANDED_WITHIN_S + 0.02))
    assert epoch <= peer.of_packets(missed_s, 0)
