"""A message on which its decoder fails costs itself and not its receiver."""

from __future__ import annotations

import logging

import pytest

from companion.link.fleet.zenoh_session import each


def test_a_message_on_which_its_decoder_fails_is_refused_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    refused: list[str] = []
    with caplog.at_level(logging.ERROR):
        taken = each(["2", "none", "x" * 5000, "3"], _number, lambda: refused.append("once"))
    assert taken == [2, 3]
    assert refused == ["once"]
    assert "ValueError: invalid literal" in caplog.text
    assert len(caplog.text) < 600


def _number(text: str) -> int | None:
    return None if text == "none" else int(text)
