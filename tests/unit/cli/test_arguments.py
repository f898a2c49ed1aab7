"""Arguments that cannot be used: one line that names the argument and where help is."""

from __future__ import annotations

import pytest

import companion.cli.main
import sitl.cli.main


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            ["fleet"],
            "companion fleet: the following arguments are required: ACTION; companion fleet --help explains it",
        ),
        (
            ["fleet", "leader", "0"],
            "companion fleet leader: argument ID: '0', expected a vehicle id from 1 to 250;"
            " companion fleet leader --help explains it",
        ),
        (
            ["monitor", "--wrong"],
            "companion monitor: unrecognized arguments: --wrong; companion monitor --help explains it",
        ),
    ],
)
def test_a_wrong_argument_of_companion_is_one_line(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        companion.cli.main.main(arguments)
    assert capsys.readouterr().err == f"{line}\n"


@pytest.mark.parametrize(
    ("words", "value"), [("-3.6e-16 5 4", [-3.6e-16, 5.0, 4.0]), ("-33. -.5 -1E+2", [-33.0, -0.5, -100.0])]
)
def test_each_negative_number_is_a_value_of_an_option(words: str, value: list[float]) -> None:
    read = companion.cli.main.parser().parse_args(["fleet", "reference", "point", "--at", *words.split()])
    assert read.at == [value]
    read = companion.cli.main.parser().parse_args(["init", "folder", "--vehicles", "2", "--origin", *words.split()])
    assert [float(word) for word in read.origin] == value


def test_control_characters_of_an_argument_are_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        companion.cli.main.main(["monitor", "--x\n\x1b[2J"])
    expected = "companion monitor: unrecognized arguments: --x??[2J; companion monitor --help explains it\n"
    assert capsys.readouterr().err == expected


def test_a_wrong_argument_of_sitl_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        sitl.cli.main.parser().parse_args(["fly"])
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.endswith("; sitl fly --help explains it\n")
