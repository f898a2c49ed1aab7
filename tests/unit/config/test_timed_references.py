"""References through samples and from Python files: what is flown, what is checked, and what no command brings."""

import pickle
import sys
from math import cos, hypot, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import convert, to_builtins
from msgspec.structs import replace

from companion.config import code_file
from companion.config.file import ConfigError
from companion.config.fleet import Envelope
from companion.config.named_files import carried, read_named
from companion.config.reference import KINDS, Reference, commanded
from companion.config.reference.code import FileReference
from companion.config.reference.samples import MOST_IN_COMMAND, MOST_SAMPLES, SamplesReference
from companion.config.reference_check import reference_problems
from companion.geometry.curves import ramped
from companion.geometry.spline import table, through
from companion.types.commands import Command, CommandName, ReferenceChange
from companion.wire.messages import decode_command, encode
from one_agent import FLEET

ROWS = (
    (0.0, 0.0, 0.0, 3.0),
    (4.0, 6.0, 2.0, 3.0),
    (9.0, 10.0, -3.0, 4.0),
    (12.0, 4.0, -6.0, 4.0),
    (20.0, 0.0, 0.0, 3.0),
)
SAMPLES = SamplesReference(samples=ROWS)
STEP_S = 1e-4
CODE = """
from math import cos, sin
def reference(time_s):
    c, s, w = cos(0.4 * time_s), sin(0.4 * time_s), 0.4
    return (5 * c, 5 * s, 3), (-5 * w * s, 5 * w * c, 0), (-5 * w * w * c, -5 * w * w * s, 0)
"""


@pytest.fixture
def beside(tmp_path: Path) -> Path:
    tmp_path.chmod(0o755)
    return tmp_path / "scenario.yaml"


def written(beside: Path, text: str, name: str) -> Path:
    path = beside.parent / name
    path.write_text(text, encoding="utf-8")
    path.chmod(0o644)
    return path


def read(beside: Path, **section: Any) -> Reference:
    """The reference of a file with this section, without the checks against a fleet."""
    plain = read_named({"reference": section}, beside)["reference"]
    return convert(plain, KINDS[section["kind"]])


def from_code(beside: Path, text: str = CODE, **keys: Any) -> Reference:
    written(beside, text, "circle.py")
    return read(beside, **{"kind": "file", "file": "circle.py", "lasts_s": 30.0} | keys)


def refusal(beside: Path, text: str, **keys: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        list(reference_problems(FLEET, from_code(beside, text, **keys)))
    (line,) = caught.value.lines
    return line.removeprefix(f"{beside.parent}/")


def is_smooth(reference: Reference) -> bool:
    """Velocity and acceleration are the derivatives, and the acceleration has no step, also before and after."""
    curve, whole_s = reference.curve(), reference.curve_s()
    for time_s in np.linspace(-0.5, whole_s + 0.5, 1777).tolist():
        (p0, v0, a0), (_, v, a), (p1, v1, a1) = (curve(time_s + shift_s) for shift_s in (-STEP_S, 0.0, STEP_S))
        if max(abs((q - p) / (2 * STEP_S) - r) for p, q, r in zip(p0, p1, v, strict=True)) > 1e-5:
            return False
        if max(abs((q - p) / (2 * STEP_S) - r) for p, q, r in zip(v0, v1, a, strict=True)) > 1e-2:
            return False
        if hypot(*(q - p for p, q in zip(a0, a1, strict=True))) > 0.02:
            return False
    return True


# ---------------------------------------------------------------- samples


def test_samples_are_flown_at_their_times_and_smoothly() -> None:
    curve = SAMPLES.curve()
    for time_s, *point in ROWS:
        assert curve(time_s)[0] == pytest.approx(point, abs=1e-9)
    assert is_smooth(SAMPLES)
    for rest_s in (-1.0, 0.0, 20.0, 99.0):
        assert curve(rest_s)[1:] == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert min(hypot(*curve(time_s)[1]) for time_s in np.arange(1.0, 19.0, 0.01)) > 0.1  # it never stops between


def test_dense_samples_of_a_curve_give_the_curve() -> None:
    rows = tuple(
        (time_s, 8.0 * sin(0.3 * time_s) ** 2, 5.0 * cos(0.2 * time_s), 3.0) for time_s in np.arange(0, 60, 0.5)
    )
    curve = SamplesReference(samples=rows).curve()
    for time_s in np.arange(5.0, 55.0, 0.13).tolist():
        (x, y, _), (vx, vy, _), _ = curve(time_s)
        assert (x, y) == pytest.approx((8.0 * sin(0.3 * time_s) ** 2, 5.0 * cos(0.2 * time_s)), abs=2e-4)
        assert (vx, vy) == pytest.approx((2.4 * sin(0.6 * time_s), -sin(0.2 * time_s)), abs=3e-3)


def test_equal_samples_are_a_stop() -> None:
    rows = (*ROWS[:3], (15.0, *ROWS[2][1:]), *((t + 10.0, *point) for t, *point in ROWS[3:]))
    stopping = SamplesReference(samples=rows)  # type: ignore[arg-type]
    assert is_smooth(stopping)
    for time_s in (9.0, 11.0, 15.0):
        assert stopping.curve()(time_s) == (ROWS[2][1:], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert SamplesReference(samples=((0.0, 1.0, 2.0, 3.0), (5.0, 1.0, 2.0, 3.0))).motions(False) == []


def test_the_first_time_is_the_beginning_and_pace_scales_it() -> None:
    later = SamplesReference(samples=tuple((t + 7.0, *point) for t, *point in ROWS), pace=0.5)  # type: ignore[misc]
    assert later.curve()(8.0)[0] == pytest.approx(ROWS[1][1:])
    assert later.curve_s() == 40.0
    speed_m_s, acceleration_m_s2 = SAMPLES.largest_pace()
    assert later.largest_pace() == pytest.approx((0.5 * speed_m_s, 0.25 * acceleration_m_s2))
    assert is_smooth(later)


def test_extremes_are_those_that_are_flown() -> None:
    motions = [SAMPLES.curve()(time_s) for time_s in np.arange(0.0, 20.0, 0.01)]
    speed_m_s, acceleration_m_s2 = SAMPLES.largest_pace()
    assert speed_m_s == pytest.approx(max(hypot(*velocity) for _, velocity, _ in motions), rel=0.02)
    assert acceleration_m_s2 == pytest.approx(max(hypot(*acceleration) for _, _, acceleration in motions), rel=0.05)
    low, high = SAMPLES.corners_enu_m()
    assert low == pytest.approx(np.min([position for position, *_ in motions], axis=0), abs=0.1)
    assert high == pytest.approx(np.max([position for position, *_ in motions], axis=0), abs=0.1)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"pace": 5.0}, "reference.pace: 5 asks for "),
        ({"samples": ((0.0, 0.0, 0.0, 3.0), (60.0, 500.0, 0.0, 3.0))}, "reference.samples: puts vehicle 1 at x = 500 m"),
        ({"samples": ((0.0, 0.0, 0.0, 3.0), (10.0, 0.0, 0.0, 30.0))}, "reference.pace: 1 gives 5.1 m/s vertically"),
        ({"samples": ((0.0, 0.0, 0.0, 30.0), (10.0, 0.0, 0.0, 3.0))}, "reference.pace: 1 gives 5.1 m/s vertically"),
        ({"samples": ((0.0, 0.0, 0.0, 3.0),)}, "reference.samples: expected at least two rows"),
        ({"samples": (ROWS[0], ROWS[2], ROWS[1])}, "reference.samples[2]: t is 4 s; expected more than 9 s"),
    ],
)  # fmt: skip
def test_samples_that_cannot_be_flown_are_refused(changed: dict[str, Any], words: str) -> None:
    problems = [
        f"{problem.field}: {problem.text}" for problem in reference_problems(FLEET, replace(SAMPLES, **changed))
    ]
    assert any(problem.startswith(words) for problem in problems), problems


def test_the_pace_that_is_advised_is_accepted() -> None:
    fast = replace(SAMPLES, pace=6.0)
    for _ in range(3):
        problems = [problem.text for problem in reference_problems(FLEET, fast)]
        if not problems:
            break
        fast = replace(fast, pace=min(float(text.split("at most ")[1].split()[0]) for text in problems))
    assert not problems and 1.0 < fast.pace < 6.0


def test_a_formation_that_turns_judges_the_turn_of_samples() -> None:
    fleet = replace(FLEET, formation_heading="course", envelope=Envelope(max_tilt_deg=45.0))
    sharp = SamplesReference(
        samples=((0.0, 0.0, 0.0, 3.0), (8.0, 10.0, 0.0, 3.0), (9.0, 10.0, 1.0, 3.0), (17.0, 0.0, 1.0, 3.0))
    )
    assert any("turns the course by up to" in problem.text for problem in reference_problems(fleet, sharp))


def test_a_csv_file_gives_its_samples(beside: Path) -> None:
    text = "\ufeff" + "x, y,z,t\n" + "".join(f"{x},{y}, {z},{t}\n\n" for t, x, y, z in ROWS)
    written(beside, text, "path.csv")
    assert read(beside, kind="samples", file="path.csv") == SAMPLES
    data = {"timeline": [{"reference": {"kind": "samples", "file": "path.csv"}}], "targets": 3}
    assert len(read_named(data, beside)["timeline"][0]["reference"]["samples"]) == len(ROWS)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "line 1: '': expected the columns t,x,y,z"),
        ("t,x,y\n0,0,0\n", "line 1: 't,x,y': expected the columns t,x,y,z"),
        (
            "t,x,y,z,yaw\n",
            "line 1: 't,x,y,z,yaw': expected the columns t,x,y,z; a reference has no yaw, each vehicle keeps its own",
        ),
        ("t,x,y,z\n0,0,0,3\n1,0,0\n", "line 3: 3 values; expected 4"),
        ("t,x,y,z\n0,0,0,3\n1,a,0,3\n", "line 3, x: 'a': expected a number from -10000 to 10000"),
        ("t,x,y,z\n0,0,nan,3\n1,0,0,3\n", "line 2, y: 'nan': expected a number from -10000 to 10000"),
        ("t,x,y,z\n1e9,0,0,3\n1,0,0,3\n", "line 2, t: '1e9': expected a number from -10000 to 10000"),
        ("t,x,y,z\n0,0,0,3\n\n0,0,0,3\n", "line 4, t: 0: expected more than 0, that of the line before"),
        ("t,x,y,z\n0,0,0,3\n", "1 samples; expected 2 to 1000"),
    ],
)
def test_a_csv_file_that_is_wrong_is_named_with_line_and_column(beside: Path, text: str, line: str) -> None:
    path = written(beside, text, "path.csv")
    with pytest.raises(ConfigError) as caught:
        read(beside, kind="samples", file="path.csv")
    assert str(caught.value) == f"{path}: {line}"


def test_a_csv_file_that_cannot_be_read_is_one_line(beside: Path) -> None:
    written(beside, "", "path.csv").write_bytes(b"\xff\xfe")
    for name, words in {
        "missing.csv": "No such file",
        "path.csv": "not UTF-8",
        "\0": "zero byte",
        ".": "Is a dir",
    }.items():
        with pytest.raises(ConfigError, match=words):
            read(beside, kind="samples", file=name)
    with pytest.raises(ConfigError, match=r"reference\.samples: goes without file"):
        read(beside, kind="samples", file="path.csv", samples=[[0, 0, 0, 0]])


def test_the_largest_samples_fit_the_file_of_a_flight(beside: Path) -> None:
    import yaml

    rows = "".join(f"{3.123456789 * i},-1234.123456789,-1234.123456789,-1234.123456789\n" for i in range(MOST_SAMPLES))
    written(beside, "t,x,y,z\n" + rows, "path.csv")
    plain = to_builtins({"reference": read(beside, kind="samples", file="path.csv")})
    assert len(yaml.safe_dump(plain)) < 100_000


# ---------------------------------------------------------------- a Python file


def test_a_function_is_flown_from_rest_to_rest(beside: Path) -> None:
    reference = from_code(beside)
    assert is_smooth(reference)
    curve = reference.curve()
    assert reference.start_enu_m == curve(-1.0)[0] == (5.0, 0.0, 3.0)
    assert curve(0.0)[1] == curve(35.0)[1] == (0.0, 0.0, 0.0)
    for time_s in (10.0, 17.3, 28.0):  # at full pace, half a ramp late
        phase = 0.4 * (time_s - 2.5)
        position, velocity, _ = curve(time_s)
        assert position == pytest.approx((5 * cos(phase), 5 * sin(phase), 3), abs=1e-6)
        assert velocity == pytest.approx((-2 * sin(phase), 2 * cos(phase), 0), abs=1e-6)
    assert curve(99.0)[0] == pytest.approx((5 * cos(12.0), 5 * sin(12.0), 3), abs=1e-6)
    assert reference.whole_s() == 35.0
    assert list(reference_problems(FLEET, reference)) == []


def test_the_code_never_runs_in_flight(beside: Path) -> None:
    counting = CODE.replace("def reference(time_s):", "calls = []\ndef reference(time_s):\n    calls.append(time_s)")
    reference = from_code(beside, counting)
    list(reference_problems(FLEET, reference))
    assert isinstance(reference, FileReference)
    calls = sys.modules[f"companion_code_{reference.sha256}"].calls
    assert calls == pytest.approx(np.linspace(0.0, 30.0, 601).tolist())
    curve = reference.curve()
    for time_s in np.arange(-1.0, 50.0, 0.1):
        curve(time_s)
    assert len(calls) == 601


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "def reference(t):\n    return (1 / (t - 2.0), 0, 0), (0, 0, 0), (0, 0, 0)\n",
            "line 2: ZeroDivisionError: float division by zero: at 2 s",
        ),
        ("def reference(t):\n    return (0, 0, 3), (0, 0, 0)\n", "ValueError: not enough values to unpack"),
        ("def reference(t):\n    return (0, 0, 3), (0, 0), (0, 0, 0)\n", "ValueError: not enough values to unpack"),
        ("def reference(t):\n    return (float('nan'), 0, 3), (0, 0, 0), (0, 0, 0)\n", "is not finite: at 0 s"),
        ("def reference(t):\n    return None\n", "TypeError: "),
        ("def motion(t):\n    return None\n", "reference: missing; expected a function reference(time_s)"),
        ("reference = 3\n", "reference: missing; expected a function reference(time_s)"),
        (
            CODE.replace("5 * s, 3)", "6 * s, 3)"),
            "at 0.00 s: velocity (-0.02, 2, 0) m/s is not the derivative of the position",
        ),
        (CODE.replace("-5 * w * w * c", "0"), "m/s^2 is not the derivative of the velocity"),
        (CODE.replace("(5 * c,", "(5 * c + (time_s > 7.02),"), "at 7.00 s: velocity"),
        ("def reference(t):\n    raise SystemExit\n", "line 2: SystemExit: at 0 s"),
    ],
)
def test_code_that_is_wrong_is_refused_before_the_flight(beside: Path, text: str, words: str) -> None:
    line = refusal(beside, text)
    assert line.startswith("circle.py: ") and words in line, line


def test_code_from_elsewhere_is_refused(beside: Path) -> None:
    path = written(beside, CODE, "circle.py")
    path.chmod(0o666)
    with pytest.raises(ConfigError, match="others may write it"):
        read(beside, kind="file", file="circle.py", lasts_s=30.0)
    with pytest.raises(ConfigError, match="own folder"):
        read(beside / "x" / "y.yaml", kind="file", file=str(path), lasts_s=30.0)


def test_a_digest_that_is_given_must_be_that_of_the_file(beside: Path) -> None:
    reference = from_code(beside)
    assert isinstance(reference, FileReference) and reference.sha256 is not None
    assert from_code(beside, sha256=reference.sha256) == reference
    with pytest.raises(ConfigError, match=f"reference.sha256: circle.py has {reference.sha256}, which"):
        from_code(beside, sha256="0" * 64)


def test_what_no_file_has_named_is_not_run(beside: Path) -> None:
    """A recording or a command that names a path runs nothing."""
    path = written(beside, "raise AssertionError\n", "never.py")
    reference = FileReference(file=str(path), lasts_s=30.0)
    with pytest.raises(ConfigError, match="is code that has not been read"):
        list(reference_problems(FLEET, reference))


def test_another_process_loads_the_file_itself(beside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = from_code(beside)
    assert pickle.loads(pickle.dumps(reference)) == reference
    pickled = pickle.dumps(reference)
    written(beside, CODE + "\n", "circle.py")
    monkeypatch.setattr(code_file, "LOADED", {})  # as that process
    with pytest.raises(ConfigError, match="sha256"):
        pickle.loads(pickled)


def test_a_copy_goes_with_the_files_of_a_flight(beside: Path, tmp_path: Path) -> None:
    reference, folder = from_code(beside), tmp_path / "run"
    folder.mkdir()
    folder.chmod(0o775)  # as with the umask of many systems
    plain = carried(to_builtins({"reference": reference}), folder)
    assert plain["reference"]["file"] == "circle.py"
    again = read(folder / "scenario.yaml", **plain["reference"])
    assert again.curve()(12.0) == reference.curve()(12.0)
    assert carried(to_builtins({"reference": again}), folder) == plain  # in its own folder nothing is copied


# ---------------------------------------------------------------- commands


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            {"kind": "file", "file": "circle.py", "lasts_s": 30.0},
            "command: reference.kind: file: a command brings no code",
        ),
        (
            {"kind": "samples", "file": "path.csv"},
            "reference.file: 'path.csv': a command brings no file; expected samples",
        ),
        (
            {"kind": "samples", "samples": [[float(i), 0.0, 0.0, 3.0] for i in range(MOST_IN_COMMAND + 1)]},
            "command: reference.samples: 51 rows; a command brings at most 50",
        ),
    ],
)
def test_no_command_brings_code_or_a_file(section: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        commanded(Path("command"), {"reference": section})
    assert words in caught.value.lines[-1]


def test_a_command_brings_samples_in_a_message() -> None:
    rows = [(float(i), 3.0 * sin(i), 0.0, 3.0) for i in range(MOST_IN_COMMAND)]
    given = SamplesReference(samples=tuple(rows), pace=0.5)
    change = ReferenceChange(1, to_builtins(given), 5.0)
    sent = decode_command(encode(Command(CommandName.REFERENCE, 1, "ground", 1, change))).content
    assert isinstance(sent, ReferenceChange)
    assert commanded(Path("command"), {"reference": sent.reference}) == given


def test_a_command_brings_samples() -> None:
    assert (
        commanded(Path("command"), {"reference": {"kind": "samples", "samples": [list(row) for row in ROWS]}})
        == SAMPLES
    )


# ---------------------------------------------------------------- curves


def test_a_table_is_exact_for_quintics() -> None:
    def quintic(t: float) -> tuple[tuple[float, ...], ...]:
        return (t**5 - t, t**3, 3.0), (5 * t**4 - 1, 3 * t**2, 0.0), (20 * t**3, 6 * t, 0.0)

    times_s = [0.0, 0.3, 1.1, 2.0]
    curve = table(times_s, [quintic(time_s) for time_s in times_s])  # type: ignore[misc]
    for time_s in np.linspace(0.0, 1.999, 50).tolist():
        for found, wanted in zip(curve(time_s), quintic(time_s), strict=True):
            assert found == pytest.approx(wanted, abs=1e-9)


def test_two_points_are_a_smooth_way_from_rest_to_rest() -> None:
    curve = through([0.0, 4.0], [(0.0, 0.0, 3.0), (8.0, 0.0, 3.0)])
    assert curve(2.0)[0] == pytest.approx((4.0, 0.0, 3.0))
    assert curve(2.0)[1] == pytest.approx((1.875 * 2.0, 0.0, 0.0))


def test_a_ramp_takes_its_time_longer() -> None:
    curve = ramped(lambda t: ((2.0 * t, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 10.0, 4.0)
    assert [curve(t)[0][0] for t in (0.0, 7.0, 14.0, 20.0)] == pytest.approx([0.0, 10.0, 20.0, 20.0])
    assert curve(7.0)[1][0] == 2.0
