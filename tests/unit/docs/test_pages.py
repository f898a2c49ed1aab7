"""README, ARCHITECTURE, CHANGELOG and docs/: links, line length, commands, paths and examples."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import companion.cli.main
import sitl.cli.main
from common import ROOT
from sitl.flight.external import load_external
from sitl.flight.scenario import load_scenario

TOP_PAGES = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CHANGELOG.md")]
PAGES = [*TOP_PAGES, *sorted((ROOT / "docs").rglob("*.md"))]
MAKEFILES = [ROOT / "Makefile", *(ROOT / name for name in ("tests/lab.mk", "deploy/package.mk", "docs/docs.mk"))]
LONGEST_LINE = 100
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")
CODE_PATH = re.compile(r"`((?:companion|sitl|tests|docs|config|deploy)/[\w./@-]+)`")


def names(pages: list[Path]) -> list[str]:
    return [str(page.relative_to(ROOT)) for page in pages]


def prose(page: Path) -> str:
    """The text without code blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """The anchors of the headings, as MkDocs and GitHub make them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def shell_lines() -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        for language, block in FENCE.findall(page.read_text(encoding="utf-8")):
            if language == "sh":
                yield from ((page, line) for line in block.replace("\\\n", " ").splitlines() if line.strip())


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_links_resolve(page: Path) -> None:
    for link in LINK.findall(prose(page)):
        if link.startswith("http"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_lines_of_prose_are_at_most_100_columns(page: Path) -> None:
    lines = [line for line in prose(page).splitlines() if not line.startswith(("|", "![", "<!--"))]
    assert [line for line in lines if len(line) > LONGEST_LINE] == []


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_every_table_has_a_head(page: Path) -> None:
    """Rows after an empty line are no table: they are shown as they stand."""
    paragraphs = re.split(r"\n\s*\n|\n(?!\|)", prose(page))
    tables = [rows.split("\n") for rows in paragraphs if rows.startswith("|")]
    assert [rows[0] for rows in tables if len(rows) < 2 or not re.fullmatch(r"[|:\- ]+", rows[1])] == []


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_paths_in_the_text_exist(page: Path) -> None:
    missing = [path for path in CODE_PATH.findall(prose(page)) if not (ROOT / path).exists()]
    assert missing == []


def test_readme_has_at_most_150_lines() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_commands_in_shell_blocks_exist_with_their_options() -> None:
    parsers = {"companion": companion.cli.main.parser(), "sitl": sitl.cli.main.parser()}
    problems = []
    for page, line in shell_lines():
        for part in re.split(r"&&|\|\||;|\|", line):
            words = shlex.split(part, comments=True)
            program = Path(words[0]).name if words else ""
            if program in parsers:
                problems += [f"{page.name}: {line}: {problem}" for problem in unknown(parsers[program], words[1:])]
            elif program == "make":
                targets = [word for word in words[1:] if "=" not in word]
                problems += [f"{page.name}: {line}: no target {name}" for name in targets if name not in make_targets()]
    assert problems == []


def unknown(parser: argparse.ArgumentParser, words: list[str]) -> Iterator[str]:
    """Subcommands and options among these words that the parser does not have."""
    options = {option for action in parser._actions for option in action.option_strings}
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for position, word in enumerate(words):
        if word.startswith("--"):
            if word.partition("=")[0] not in options:
                yield f"no option {word}"
        elif groups and not word.startswith(("-", "$")):
            if word in groups[0].choices:
                yield from unknown(groups[0].choices[word], words[position + 1 :])
            else:
                yield f"no command {word}"
            return


def make_targets() -> set[str]:
    return {target for file in MAKEFILES for target in re.findall(r"^([\w-]+):", file.read_text("utf-8"), re.MULTILINE)}


def test_scenario_of_the_page_flies(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "writing-a-scenario.md").read_text(encoding="utf-8")
    scenario, mixed, steps = [block for language, block in FENCE.findall(text) if language == "yaml"]
    file = tmp_path / "scenario.yaml"
    file.write_text(scenario, encoding="utf-8")
    assert [member.id for member in load_scenario(file).fleet.vehicles] == [1, 2, 3, 4, 5]
    longer = yaml.safe_load(scenario)
    longer["timeline"][4:4] = yaml.safe_load(steps)["timeline"]
    longer["stand_in"] = yaml.safe_load(mixed)["stand_in"]
    file.write_text(yaml.safe_dump(longer), encoding="utf-8")
    assert len(load_scenario(file).timeline) == 10


def test_vehicle_file_of_the_external_page_loads(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "external.md").read_text(encoding="utf-8")
    (example,) = [block for language, block in FENCE.findall(text) if language == "yaml"]
    file = tmp_path / "external.yaml"
    file.write_text(example, encoding="utf-8")
    assert [vehicle.id for vehicle in load_external(file)] == [1, 2]
