"""`companion law`: a bad law is found with one clear line, those that are shipped pass, and a new one passes at once."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.config.law import BUILT_IN, LawSection, law_in_file, law_problems
from companion.tools.laws import check_file
from tests.helpers.bad_laws import BAD_LAWS, FLOWN, HEAD, law, write_law

FOUND = {
    "raises": "line 8: ZeroDivisionError",
    "not_a_number": "within 1 m of its neighbour it gives (nan, 0.0, 0.0) m/s^2; expected numbers up to 500",
    "huge": "within 1 m of its neighbour it gives (1000000000.0, 0.0, 0.0) m/s^2; expected numbers up to 500",
    "sleeps": "line 1: imports time; expected code that computes from its arguments alone",
    "imports_sockets": "line 1: imports socket; expected code that computes from its arguments alone",
    "absolute": "where the whole formation is elsewhere; expected differences of positions alone",
    "hidden_state": "asked twice it answers differently; expected no state of its own but `memory`",
}
SUBTLE = {
    # Each passes the few calls of a configuration; the longer check finds it.
    "any state": law("        if len(neighbours) > 20:\n            return (float('inf'), 0.0, 0.0)\n" + FLOWN),
    "same again": law(
        "        KEPT.append(own)\n        if len(KEPT) % 13:\n    " + FLOWN + "        return (0.0, 0.0, 0.0)\n",
        "KEPT = []\n",
    ),
    "moved": law(
        "        x, y, z = Cooperative().acceleration(own, neighbours, reference)\n"
        "        return (x, y, z - 0.1 * max(0.0, own.position_enu_m[2] - 105.0))\n"
    ),
    "turned": law(
        "        x, y, z = Cooperative().acceleration(own, neighbours, reference)\n        return (x, 1.2 * y, z)\n"
    ),
    "settles": law(
        "        if reference is None:\n    "
        + FLOWN
        + "        x, y, z = Cooperative().acceleration(own, neighbours, reference)\n"
        "        e = [a - b for a, b in zip(own.velocity_enu_m_s, reference.velocity_enu_m_s)]\n"
        "        return (x + 4.0 * e[0], y + 4.0 * e[1], z + 4.0 * e[2])\n"
    ),
    "time of a call": law("        sum(range(800000))\n" + FLOWN),
}


def failed(path: Path) -> dict[str, str]:
    return {finding.subject: finding.found for finding in check_file(path) if not finding.passed}


@pytest.mark.parametrize("name", list(BAD_LAWS))
def test_a_bad_law_is_found_with_one_line(name: str, tmp_path: Path) -> None:
    (line,) = failed(write_law(tmp_path, name, BAD_LAWS[name])).values()
    assert FOUND[name] in line
    assert "\n" not in line


@pytest.mark.parametrize("subject", list(SUBTLE))
def test_what_a_few_calls_do_not_find(subject: str, tmp_path: Path) -> None:
    found = failed(write_law(tmp_path, "bad", SUBTLE[subject]))
    assert subject in found, found


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_shipped_laws_pass(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["law", "check", name])
    assert code == 0, capsys.readouterr().out


def test_weights_of_another_number_or_sum(tmp_path: Path) -> None:
    for given in ("(1.0,)", "tuple([1.0] * len(prcs))"):
        weights = f"\n    def weights(self, leads, prcs):\n        return {given}\n"
        (line,) = failed(write_law(tmp_path, "bad", law(FLOWN) + weights)).values()
        assert "line 10: weights gives (1.0," in line
        assert "expected one for each with a sum of 1, or none" in line


@pytest.mark.parametrize("given", ["(1.0, 2.0)", "None", "'abc'", "5.0"])
def test_an_answer_of_another_shape(given: str, tmp_path: Path) -> None:
    (line,) = failed(write_law(tmp_path, "bad", law(f"        return {given}\n"))).values()
    assert f"line 7: with no neighbour its acceleration is {given}; expected (x, y, z), three numbers" in line


@pytest.mark.parametrize("method", ["remember", "publish"])
@pytest.mark.parametrize("given", ["()", "None", "((1.0, 2.0),)", "(5.0,)"])
def test_vectors_of_another_shape(method: str, given: str, tmp_path: Path) -> None:
    source = law(FLOWN, memory=int(method == "remember")) + f"    publishes = {int(method == 'publish')}\n\n"
    source += f"    def {method}(self, own, neighbours, reference):\n        return {given}\n"
    found = failed(write_law(tmp_path, "bad", source))
    assert list(found) == ["first calls"]
    assert found["first calls"].startswith(f"line 11: {method} gives {given}; expected a tuple of (x, y, z)")


def test_a_law_that_needs_a_neighbour(tmp_path: Path) -> None:
    source = law("        return (1.0 / len(neighbours), 0.0, 0.0)\n")
    assert "line 8: ZeroDivisionError" in failed(write_law(tmp_path, "bad", source))["first calls"]


def test_a_number_without_bounds(tmp_path: Path) -> None:
    text = HEAD + "class Mine(Law, frozen=True):\n    gain: float = 1.0\n\n"
    text += "    def acceleration(self, own, neighbours, reference):\n" + FLOWN
    assert "gain without bounds" in failed(write_law(tmp_path, "mine", text))["parameters"]


@pytest.mark.parametrize("declared", ["gain: float = 1.0", "gain = 1.0", "feedforward = 0.5"])
def test_a_configuration_refuses_what_the_check_refuses_of_parameters(declared: str, tmp_path: Path) -> None:
    text = HEAD + f"class Mine(Law, frozen=True):\n    {declared}\n    MOST = 2.0\n\n"
    file = write_law(tmp_path, "mine", text + "    def acceleration(self, own, neighbours, reference):\n" + FLOWN)
    (found,) = failed(file).values()
    problems = list(law_problems(LawSection(**law_in_file(str(file))), "law"))
    assert [problem[:2] for problem in problems] == [("law.file", f"{file}: {found}")]
    assert found.startswith(
        declared.split()[0].rstrip(":") + (" without bounds" if ":" in declared else " has no type")
    )


def test_a_new_law_passes_and_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "lab"
    assert main(["law", "new", "my_law", "--folder", str(folder)]) == 0
    assert f"companion law check {folder}/my_law.py" in capsys.readouterr().out
    assert "class MyLaw(Law" in (folder / "my_law.py").read_text(encoding="utf-8")
    assert main(["law", "check", str(folder / "my_law.py"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [finding["passed"] for finding in printed["findings"]] == [True] * 8
    namespace: dict[str, object] = {"__file__": str(folder / "test_my_law.py")}
    exec((folder / "test_my_law.py").read_text(encoding="utf-8"), namespace)
    test = namespace["test_the_law_passes_its_check"]
    assert callable(test)
    test()
    assert main(["law", "new", "my_law", "--folder", str(folder)]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["Mine", "cooperative", "my law", "../x", "test_mine", "mine_test"])
def test_names_that_no_law_can_have(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["law", "new", name, "--folder", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["law", "check", str(tmp_path / "none.py")]) == 2
    assert main(["law", "check", "nosuch"]) == 2
    assert main(["law", "check", "cooperative", "--set", "gain=1"]) == 1
    output = capsys.readouterr()
    assert "none.py: is no file" in output.err
    assert "'nosuch' is no law" in output.err
    assert "FAILED gain" in output.out


def test_the_list_has_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["law", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines][: len(BUILT_IN)] == list(BUILT_IN)
    said = [line.split(maxsplit=1)[1] for line in lines]
    assert all(len(text.split()) > 7 for text in said)
    assert len(set(said)) == len(said)
