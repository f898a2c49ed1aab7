"""`companion doctor --host`: arguments, exit codes and output."""

from __future__ import annotations

import json

import pytest

from companion.cli.main import main


def test_the_host_is_checked_without_a_vehicle_file(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["doctor", "--host"])
    lines = capsys.readouterr().out.splitlines()
    assert code == int(any(line.startswith("problem ") for line in lines))
    assert any(" Python " in line for line in lines)


def test_the_findings_are_available_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    main(["doctor", "--host", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert {finding["verdict"] for finding in found["findings"]} <= {"ok", "not known", "warning", "problem"}
    assert "kernel" in {finding["subject"] for finding in found["findings"]}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [(["doctor"], "--config FILE is needed"), (["doctor", "--host", "--fix"], "--host changes nothing")],
)
def test_arguments_that_do_not_fit_are_refused(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert reason in capsys.readouterr().err


def test_a_vehicle_file_that_is_missing_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--host", "--config", "missing.yaml"]) == 2
    assert "missing.yaml" in capsys.readouterr().err
