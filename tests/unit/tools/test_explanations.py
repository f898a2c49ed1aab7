"""The table of explanations and `companion explain`."""

import re
import runpy

import pytest

from common import ROOT
from companion.cli.main import main
from companion.config.law import GAINS
from companion.report.findings import FindingKind
from companion.tools.explanations import COLUMNS, listing, report
from companion.types.code_table import code_entries, code_table
from companion.types.flight import HealthFlag
from companion.types.generated.codes import TEXTS
from companion.types.notices import Code

CODES = {str(code) for code in Code} | {str(flag) for flag in HealthFlag}


def test_every_code_and_health_flag_is_explained() -> None:
    assert sorted(CODES - code_entries().keys()) == []


def test_every_explanation_is_of_a_code() -> None:
    assert sorted(code_entries().keys() - CODES) == []


def test_health_flags_are_the_first_section_and_stand_in_both_orders() -> None:
    flags = sorted(code_table().sections["Health flags"])
    assert sorted(code_table().causes_first) == sorted(code_table().worst_first) == flags == sorted(HealthFlag)


def test_every_flag_has_a_text_and_every_topic_is_one_of_a_report() -> None:
    assert all(TEXTS[flag] for flag in HealthFlag)
    assert {entry.topic for entry in code_entries().values()} <= {str(kind) for kind in FindingKind}


def test_no_code_is_explained_twice() -> None:
    assert sum(len(entries) for entries in code_table().sections.values()) == len(code_entries())


@pytest.mark.parametrize("code", sorted(code_entries()))
def test_symptom_cause_and_remedy_are_sentences(code: str) -> None:
    entry = code_entries()[code]
    for text in (entry.symptom, entry.cause, entry.remedy):
        assert text.endswith(".")
        assert "  " not in text
    assert all(len(line) <= COLUMNS for line in report(code).splitlines())


def test_the_gains_in_an_advice_are_parameters_of_laws() -> None:
    gains = {name for entry in code_entries().values() for name in re.findall(r"`(\w+_1_s2?)`", entry.remedy)}
    assert gains == set(GAINS)


def test_no_advice_sends_the_reader_to_another_code() -> None:
    sent = re.compile(r"\b(?:As for|See|see|as with|same as) (?:the )?`?([A-Z]+_[A-Z_]+)")
    found = {code: sent.search(entry.remedy) for code, entry in code_entries().items()}
    assert {code: match[0] for code, match in found.items() if match} == {}


def test_explain_prints_the_entry_whatever_the_case(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "slot_too_close"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "SLOT_TOO_CLOSE"
    assert [line.split()[0] for line in printed if line[2:3].strip()] == [
        "SLOT_TOO_CLOSE",
        "symptom",
        "cause",
        "remedy",
    ]


def test_explain_lists_all_codes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain"]) == 0
    assert capsys.readouterr().out.strip() == listing()
    assert all(f"  {code} " in listing() for code in code_entries())
    assert all(len(line) <= COLUMNS for line in listing().splitlines())


def test_explain_refuses_an_unknown_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "NO_SUCH_CODE"]) == 2
    assert "NO_SUCH_CODE" in capsys.readouterr().err


def test_the_enumerations_are_those_of_the_table() -> None:
    generated = ROOT / "companion" / "types" / "generated" / "codes.py"
    made = runpy.run_path(str(ROOT / "docs" / "generate" / "code_files.py"))["enumerations"]()
    assert generated.read_text(encoding="utf-8") == made
