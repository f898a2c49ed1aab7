"""`companion fleet`: its command line, and the words for what vehicles answer and check. The rest is flown in tests/fleet."""

import json
import logging
from pathlib import Path

import pytest
from msgspec.structs import replace
from test_director import status

from companion.cli import main
from companion.ground.answers import answer_lines, answers_as_data, readiness_as_data, readiness_lines, status_lines
from companion.ground.readiness import checks_of
from companion.ground.session import Answer, operator_here
from companion.link.log import COMMANDS_A_SECOND, CommandLog
from companion.types import Command, CommandName, CommandReply, HealthFlag, PositionError

PAIR = str(Path(__file__).parents[2] / "config" / "fleets" / "pair.yaml")
ANSWERS = {
    2: Answer(CommandReply(2, 9, False, "arm: attitude \x1b[31mstale"), 0.0314),
    1: Answer(CommandReply(1, 9, True, "arm"), 0.012),
    3: None,
}


def test_each_vehicle_has_a_line_with_its_answer_and_time() -> None:
    assert answer_lines(ANSWERS, 3.0) == [
        "vehicle 1   accepted   12 ms  arm",
        "vehicle 2   refused    31 ms  arm: attitude ?[31mstale",
        "vehicle 3   missing           no answer within 3 s",
    ]


def test_the_same_as_data() -> None:
    data = json.loads(json.dumps(answers_as_data(ANSWERS, 3.0)))
    assert [(v["vehicle_id"], v["answer"], v["after_s"]) for v in data] == [
        (1, "accepted", 0.012),
        (2, "refused", 0.0314),
        (3, "missing", None),
    ]


FIT = replace(status(1), peers=(2,), battery_percent=80.0, position_error=PositionError(0.1, 0.2))


def test_a_vehicle_in_order_is_ready() -> None:
    checks = checks_of(replace(FIT, flags=(HealthFlag.LEADER_LOST,)), (1, 2), 1)
    assert all(check.fit for check in checks)
    lines = readiness_lines({1: checks}, [], 3.0)
    assert lines[0] == "vehicle 1  ready"
    assert "  battery     ok  80 %" in lines
    assert "  estimator   ok  error 0.10 m in the plane, 0.20 m in height" in lines
    assert readiness_as_data({1: checks}, [2])[1] == {"vehicle_id": 2, "ready": False, "checks": []}


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        ({"flags": (HealthFlag.MODE_STALE,)}, "autopilot", "flight mode older than allowed"),
        ({"flags": (HealthFlag.POSITION_JUMPED,)}, "estimator", "jumped too far"),
        ({"lacks": ("battery: 15 %; wanted: at least 40 %",)}, "battery", "15 %; wanted"),
        ({"flags": (HealthFlag.FRAME_UNKNOWN,)}, "origin", "origin is unknown"),
        ({"flags": (HealthFlag.FENCE,)}, "origin", "outside the fence"),
        ({"peers": ()}, "peers", "does not hear 2"),
        ({"formation_hash": 2}, "fleet file", "another one than this"),
        ({"lacks": ("separation: in the plane vehicle 2 is 0.40 m",)}, "separation", "in the plane vehicle 2"),
        ({"lacks": ("altitude: on the ground vehicle 2 is 3.0 m above",)}, "separation", "altitude: on the ground"),
        ({"lacks": ("COM_OF_LOSS_T: not found",)}, "parameters", "COM_OF_LOSS_T"),
    ],
)
def test_whatever_is_wrong_is_one_check_that_says_so(change: dict[str, object], name: str, words: str) -> None:
    checks = checks_of(replace(FIT, **change), (1, 2), 1)  # type: ignore[arg-type]
    wrong = [check for check in checks if not check.fit]
    assert [check.name for check in wrong] == [name]
    assert words in wrong[0].found
    assert readiness_lines({1: checks}, [], 3.0)[0] == "vehicle 1  not ready"


def test_every_flag_is_somebodys() -> None:
    for flag in set(HealthFlag) - {HealthFlag.LEADER_LOST}:
        checks = checks_of(replace(FIT, flags=(flag,)), (1, 2), 1)
        assert sum(not check.fit for check in checks) == 1, flag


def test_the_status_says_who_holds_command_and_who_is_silent() -> None:
    lines = status_lines({1: replace(FIT, holder="anna@ground")}, [2], 3.0)
    assert "commanded by anna@ground" in lines[0]
    assert lines[1] == "vehicle 2   missing: nothing heard of it for 3 s"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["hold", "--fleet", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["hold", "--fleet", PAIR, "--only", "7"], "vehicle 7 is not in"),
        (["leader", "7", "--fleet", PAIR], "expected some of 1, 2"),
        (["hold", "--fleet", PAIR, "--connect", "nonsense"], '--connect "nonsense": expected PROTOCOL/HOST:PORT'),
        (["hold", "--fleet", PAIR, "--only", "300"], "expected a vehicle's id from 1 to 250"),
        (["hold", "--fleet", PAIR, "--as", "two words"], "expected 1 to 63 letters"),
        (["hold", "--fleet", PAIR, "--wait-s", "nan"], "expected seconds from 0.1 to 60"),
        (["formation", "star", "--spacing", "3", "--fleet", PAIR], "invalid choice: 'star'"),
        (["formation", "line", "--fleet", PAIR], "--spacing"),
        (["formation", "line", "--spacing", "0", "--fleet", PAIR], "expected metres above 0, up to 1000"),
        (["formation", "line", "--spacing", "3", "--heading", "999", "--fleet", PAIR], "expected degrees"),
        (["formation", "line", "--spacing", "3", "--only", "1", "--fleet", PAIR], "--only"),
        (["hold"], "--fleet"),
        (["dance", "--fleet", PAIR], "invalid choice: 'dance'"),
    ],
)
def test_what_cannot_be_asked_ends_with_2_and_words(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["fleet", *arguments])
    except SystemExit as usage:
        code = int(usage.code or 0)
    assert code == 2
    assert words in capsys.readouterr().err


def test_the_operator_has_a_name_that_vehicles_take(monkeypatch: pytest.MonkeyPatch) -> None:
    import re

    from companion.wire.ground import OPERATOR

    assert re.fullmatch(OPERATOR, operator_here())
    assert operator_here() == operator_here()
    monkeypatch.setattr("companion.ground.session.getpass.getuser", lambda: "_häns meier")
    monkeypatch.setattr("companion.ground.session.socket.gethostname", lambda: "h" * 100)
    assert re.fullmatch(OPERATOR, operator_here())

    def nobody() -> str:
        raise KeyError("getpwuid(): uid not found: 1234")

    monkeypatch.setattr("companion.ground.session.getpass.getuser", nobody)
    assert operator_here().startswith("operator@")


def test_every_command_is_a_line_and_a_flood_of_them_a_number(caplog: pytest.LogCaptureFixture) -> None:
    log, command = CommandLog(), Command(CommandName.ARM, 12, "anna@ground", 7)
    with caplog.at_level(logging.INFO):
        for _ in range(COMMANDS_A_SECOND + 30):
            log.answered(command, CommandReply(1, 12, False, "old command"), 100.5)
        log.answered(command, CommandReply(1, 12, True, "arm"), 101.2)
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "command arm, number 12 of anna@ground: refused, old command"
    assert lines[COMMANDS_A_SECOND:] == ["30 more commands", "command arm, number 12 of anna@ground: accepted, arm"]
