"""Which fleet file a replay uses."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.cli.main import main
from companion.config.fleet import FleetConfig
from companion.monitor import live_page
from companion.monitor.live_page import LivePage, with_file
from made_flights import fleet_of

FLOWN = fleet_of(3)


def replayed(fleet: FleetConfig | None) -> LivePage:
    """A replay with this fleet as --fleet-file."""
    return LivePage(
        fleet_name="*",
        fleet=fleet,
        fleet_file=Path("here.yaml") if fleet else None,
        endpoints=(),
        endpoints_are_guessed=False,
        identity=None,
        listen="127.0.0.1:0",
        control=False,
        tiles=None,
        mavlink=None,
        record=None,
        replay=Path("flight"),
    )


@pytest.mark.parametrize("fleet", [None, fleet_of(3)])
def test_without_a_difference_nothing_is_said(fleet: FleetConfig | None, capsys: pytest.CaptureFixture[str]) -> None:
    assert with_file({FLOWN.name: FLOWN}, replayed(fleet)) == {FLOWN.name: FLOWN}
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (fleet_of(3, separation_m=1.0), "here.yaml is not the fleet file of this flight"),
        (replace(FLOWN, name="other"), "here.yaml is of fleet other, this flight of golden"),
    ],
)
def test_a_file_that_differs_is_one_line(given: FleetConfig, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert with_file({FLOWN.name: FLOWN}, replayed(given))[given.name] is given
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1


def test_a_replay_does_not_read_the_current_fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_text("name: [")
    monkeypatch.setenv("COMPANION_FLEET", str(broken))
    shown: list[LivePage] = []
    monkeypatch.setattr(live_page, "run_live_page", shown.append)
    assert main(["monitor", "--replay", str(tmp_path)]) == 0
    assert [page.fleet for page in shown] == [None]
