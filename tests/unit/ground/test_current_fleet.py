"""The fleet file and the endpoints of a command: options, environment, saved current fleet."""

import socket
from pathlib import Path

import pytest

from common import ROOT
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.ground.current_fleet import (
    current_file,
    forget_current,
    load_current,
    save_current,
    select,
    simulation_endpoints,
    unreachable,
)

PAIR = ROOT / "config" / "fleets" / "pair.yaml"
HERE, THERE = "tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    return {"XDG_CONFIG_HOME": str(tmp_path / "xdg")}


def test_nothing_is_selected_by_default(environment: dict[str, str]) -> None:
    selection = select(None, (), None, environment)
    assert (selection.fleet, selection.connect) == (None, ())
    assert str(selection) == "no current fleet; endpoints of the fleet file; no identity"


def test_an_option_wins_over_the_environment_and_that_over_the_saved_fleet(environment: dict[str, str]) -> None:
    save_current(PAIR, [HERE], None, environment)
    assert str(select(None, (), None, environment)) == (
        f"fleet file {PAIR} (current fleet); endpoints {HERE} (current fleet); no identity"
    )
    environment |= {"COMPANION_FLEET": "other.yaml", "COMPANION_CONNECT": f"{HERE}, {THERE}"}
    assert str(select(None, (), None, environment)) == (
        f"fleet file other.yaml (COMPANION_FLEET); endpoints {HERE}, {THERE} (COMPANION_CONNECT); no identity"
    )
    assert str(select(Path("third.yaml"), [THERE], None, environment)) == (
        f"fleet file third.yaml (--fleet); endpoints {THERE} (--connect); no identity"
    )


def test_saved_endpoints_are_not_used_with_another_fleet(environment: dict[str, str]) -> None:
    save_current(PAIR, [HERE], None, environment)
    assert select(Path("other.yaml"), (), None, environment).connect == ()
    assert select(PAIR, (), None, environment).connect == (HERE,)


def test_an_identity_is_that_of_an_option_the_environment_or_the_saved_fleet(environment: dict[str, str]) -> None:
    save_current(PAIR, (), Path("/saved"), environment)
    assert select(None, (), None, environment).identity == Path("/saved")
    assert select(Path("other.yaml"), (), None, environment).identity is None
    environment |= {"COMPANION_IDENTITY": "/named"}
    assert select(None, (), None, environment).identity == Path("/named")
    assert select(None, (), Path("given"), environment).identity == Path("given")


def test_a_saved_fleet_is_forgotten(environment: dict[str, str]) -> None:
    save_current(PAIR, (), None, environment)
    forget_current(environment)
    forget_current(environment)
    assert load_current(environment) is None


def test_a_damaged_saved_fleet_names_its_file(environment: dict[str, str]) -> None:
    file = save_current(PAIR, (), None, environment)
    file.write_text("{")
    with pytest.raises(ConfigError, match=r"current_fleet\.json: cannot be used: .*--clear"):
        select(None, (), None, environment)
    assert select(PAIR, [HERE], None, environment).connect == (HERE,)


@pytest.mark.parametrize("base", [{}, {"XDG_CONFIG_HOME": "relative"}])
def test_without_a_config_folder_the_home_folder_has_it(base: dict[str, str]) -> None:
    assert current_file(base) == Path.home() / ".config" / "companion" / "current_fleet.json"


def test_a_simulated_vehicle_listens_at_a_port_of_its_id() -> None:
    assert simulation_endpoints([1, 16]) == ("tcp/127.0.0.1:7448", "tcp/127.0.0.1:7463")


def test_use_saves_shows_and_clears(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", environment["XDG_CONFIG_HOME"])
    assert main(["fleet", "use", str(PAIR), "--connect", HERE]) == 0
    assert main(["fleet", "use"]) == 0
    shown = f"fleet file {PAIR} (current fleet); endpoints {HERE} (current fleet); no identity"
    assert capsys.readouterr().out.splitlines() == [f"saved in {current_file(environment)}", shown, shown]
    assert main(["fleet", "use", "--clear"]) == 0
    assert capsys.readouterr().out == "no current fleet; endpoints of the fleet file; no identity\n"


@pytest.mark.parametrize("arguments", [["nowhere.yaml"], [str(PAIR), "--connect", "nonsense"]])
def test_use_refuses_what_cannot_be_used(
    arguments: list[str], environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", environment["XDG_CONFIG_HOME"])
    assert main(["fleet", "use", *arguments]) == 2
    assert load_current(environment) is None


# ---------------------------------------------------------------- endpoints that cannot be reached


def test_an_endpoint_without_a_listener_is_unreachable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        there, refused = (f"tcp/127.0.0.1:{s.getsockname()[1]}" for s in (server, unused))
        assert unreachable([there, refused], linked=()) == {refused: "connection refused; no agent listens there"}


def test_an_unknown_host_is_named() -> None:
    assert unreachable(["tcp/no-such-host.invalid:7447"], ()) == {
        "tcp/no-such-host.invalid:7447": "unknown host no-such-host.invalid"
    }


def test_an_endpoint_over_udp_needs_a_link() -> None:
    endpoint = "udp/127.0.0.1:7447"
    assert unreachable([endpoint], linked=[endpoint]) == {}
    assert unreachable([endpoint], ())[endpoint].startswith("no link over udp to 127.0.0.1")
