"""All errors of a file are reported at once, in file order, each once; checks run as far as their fields are valid."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pytest
from msgspec import Meta

from companion.config.file import ConfigError, convert
from companion.config.fleet import PeerLimits
from companion.config.validation import INVALID, InvalidFieldError, Problem, each, needs, unless_invalid
from companion.config.values import Section


class Point(Section, frozen=True, tag_field="kind", tag="point"):
    at_m: tuple[float, float]


class Disc(Section, frozen=True, tag_field="kind", tag="disc"):
    radius_m: Annotated[float, Meta(gt=0, le=10)]
    at_m: tuple[float, float] = (0.0, 0.0)


class Plan(Section, frozen=True):
    first_s: Annotated[float, Meta(ge=0)]
    last_s: float
    areas: tuple[Point | Disc, ...] = ()
    heights_m: dict[Annotated[int, Meta(ge=1)], float] = msgspec.field(default_factory=dict)
    name: str | None = None


def lines_of(data: Any, check: Any = None) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        convert(Path("f"), data, Plan, check)
    assert str(caught.value).splitlines() == list(caught.value.lines)
    return [line.removeprefix("f: ") for line in caught.value.lines]


def order(plan: Plan) -> Iterator[Problem]:
    if plan.last_s < plan.first_s:
        yield Problem("last_s", "is before first_s")


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"one": 1.0, "two": 2.0}, "heights_m.one: the key 'one': expected a whole number (and 1 more like it)"),
        ({"1": 1.0}, "heights_m.1: the key '1': expected a whole number; a number has no quotes"),
        ({0: 1.0, 2: 2.0}, "heights_m.0: the key 0: expected a whole number >= 1"),
        ({None: 1.0}, "heights_m.None: the key empty: expected a whole number"),
    ],
)
def test_keys_that_are_no_ids_are_one_error_and_no_check_uses_them(keys: dict[Any, float], line: str) -> None:
    def check(plan: Plan) -> Iterator[Problem]:
        yield from (Problem("heights_m", "unsorted") for _ in sorted({1} ^ plan.heights_m.keys()))

    assert lines_of({"first_s": 1.0, "last_s": 2.0, "heights_m": keys}, check) == [line]


@pytest.mark.parametrize("data", [[[0, 0, 0]], "1,0,0,0\n2,3,0,0", 7, True])
def test_a_file_that_is_no_section_is_one_error_where_a_check_needs_it(data: Any) -> None:
    (line,) = lines_of(data, lambda plan: order(plan) if plan.name else ())
    assert "expected a section with keys" in line


def test_no_message_quotes_a_whole_file() -> None:
    long = "x" * 100_000
    for data in (
        long,
        {"first_s": long, "last_s": 1},
        {long: 1},
        {"first_s": 1, "last_s": 2, "areas": [{"kind": long}]},
    ):
        assert all(len(line) < 1000 for line in lines_of(data))
    assert len(lines_of({f"key{n}": n for n in range(1000)})) < 60


def test_all_errors_are_reported_in_file_order() -> None:
    data = {
        "areas": [
            {"kind": "disc", "radius_m": 11, "radus": 1},
            {"kind": "point"},
            7,
            {"kind": "disk"},
            {"at_m": [1, 2]},
        ],
        "last_s": "late",
        "nam": "x",
        "heights_m": {0: 1.0, 2: "high"},
    }
    assert lines_of(data) == [
        "areas[0].radius_m: 11: expected a number <= 10.0",
        'areas[0].radus: unknown key; did you mean "radius_m"?',
        "areas[1].at_m: missing; this key is required",
        "areas[2]: 7: expected a section with keys",
        "areas[3].kind: 'disk': expected one of disc, point; did you mean \"disc\"?",
        "areas[4].kind: missing; expected one of disc, point",
        "last_s: 'late': expected a number",
        'nam: unknown key; did you mean "name"?',
        "heights_m.0: the key 0: expected a whole number >= 1",
        "heights_m.2: 'high': expected a number",
        "first_s: missing; this key is required",
    ]


def test_a_key_in_the_wrong_section_is_named_with_its_path() -> None:
    lines = lines_of(
        {"first_s": 1, "last_s": 2, "radius_m": 3, "areas": [{"kind": "point", "at_m": [1], "heights_m": 2}]}
    )
    assert 'radius_m: unknown key; did you mean "areas[N].radius_m"?' in lines
    assert "areas[0].heights_m: unknown key; expected one of at_m" in lines


def test_a_check_runs_when_the_fields_that_it_needs_are_valid() -> None:
    bad_area = {"areas": [{"kind": "point", "at_m": [1]}]}
    assert lines_of({"first_s": 2, "last_s": 1} | bad_area, order) == [
        "last_s: is before first_s",
        "areas[0].at_m: expected a list of length 2, got 1",
    ]
    assert lines_of({"first_s": -2, "last_s": "x"}, order) == [
        "first_s: -2: expected a number >= 0.0",
        "last_s: 'x': expected a number",
    ]


def test_wrong_length_and_wrong_items_are_both_reported() -> None:
    data = {"first_s": 0, "last_s": 1, "areas": [{"kind": "point", "at_m": ["a", 1, 2]}]}
    assert lines_of(data) == [
        "areas[0].at_m: expected a list of length 2, got 3",
        "areas[0].at_m[0]: 'a': expected a number",
    ]


def test_every_number_that_is_not_finite_is_reported() -> None:
    data = {"first_s": float("nan"), "last_s": float("inf"), "heights_m": {1: float("-inf")}}
    assert lines_of(data) == [
        "first_s: nan is not a finite number",
        "last_s: inf is not a finite number",
        "heights_m.1: -inf is not a finite number",
    ]


def test_a_key_with_a_line_break_stays_in_one_line() -> None:
    assert lines_of({"first_s": 0, "last_s": 1, "a\nb": 1}) == [
        "a\\nb: unknown key; expected one of first_s, last_s, areas, heights_m, name"
    ]


@pytest.mark.parametrize(
    "use",
    [
        lambda x: x.field, lambda x: x[0], list, len, bool, float, abs, lambda x: x < 1.0, lambda x: x > 1.0, lambda x: x + 1,
        lambda x: 2.0 - x, lambda x: f"{x:g}", lambda x: x == 3, lambda x: 3 in x, lambda x: {x}, lambda x: needs(x),
    ],
)  # fmt: skip
def test_any_use_of_an_invalid_value_ends_a_check(use: Any) -> None:
    def check() -> Iterator[Problem]:
        yield Problem("a", "found before")
        use(INVALID)
        yield Problem("b", "not reached")

    assert list(each(check(), [Problem("c", "of the next check")])) == [
        Problem("a", "found before"),
        Problem("c", "of the next check"),
    ]
    assert unless_invalid(lambda: use(INVALID)) is INVALID
    with pytest.raises(InvalidFieldError):
        use(INVALID)


def test_no_peer_state_is_fresh_for_longer_than_its_acceleration_predicts_a_motion() -> None:
    """With 0.5 s two vehicles that exchange their slots met at 0.8 of separation_m when one fell silent; with 0.3 s at 1.0."""
    assert convert(Path("f"), {"max_age_s": 0.3}, PeerLimits).max_age_s == 0.3
    with pytest.raises(ConfigError, match=r"max_age_s: 0\.5: expected a number <= 0\.3"):
        convert(Path("f"), {"max_age_s": 0.5}, PeerLimits)
