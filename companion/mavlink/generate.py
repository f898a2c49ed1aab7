"""Writes the MAVLink dialect of this project with pymavlink's own generator: `make mavlink`.

    python -m companion.mavlink.generate            write companion/mavlink/generated/
    python -m companion.mavlink.generate --check    change nothing; exit code 1 where it is not what would be written

pymavlink's dialects have all messages, texts and names: 5 MB of each agent's memory. Here are the messages and names that the
code uses, without texts, and of every other message what its checksum and its receiver need (`codec.py`).
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TextIO

import pymavlink
import pymavlink.dialects.v20
from pymavlink.generator import mavgen_python, mavparse

# common.xml plus a few messages that PX4 already sends, among them CURRENT_MODE (436).
SOURCE = "development.xml"
GENERATED = Path(__file__).parent / "generated"
MADE_WITH = "# Made with pymavlink "
FASTCRC = "    import fastcrc\n    mcrf4xx = fastcrc.crc16.mcrf4xx\n"
CHECKSUM = "    from companion.mavlink.generated import mcrf4xx\n"

# Messages whose fields `companion`, `sitl` or their tests use. The ids of all are known.
MESSAGES = """
    ALTITUDE ATTITUDE ATTITUDE_QUATERNION ATTITUDE_TARGET AUTOPILOT_VERSION BATTERY_STATUS COMMAND_ACK COMMAND_INT COMMAND_LONG
    CURRENT_MODE ESTIMATOR_STATUS EXTENDED_SYS_STATE FILE_TRANSFER_PROTOCOL GLOBAL_POSITION_INT GPS_GLOBAL_ORIGIN GPS_RAW_INT
    HEARTBEAT HIGHRES_IMU HOME_POSITION LOCAL_POSITION_NED LOG_DATA LOG_ENTRY LOG_ERASE LOG_REQUEST_DATA LOG_REQUEST_END
    LOG_REQUEST_LIST MESSAGE_INTERVAL MISSION_ACK MISSION_CLEAR_ALL MISSION_COUNT MISSION_REQUEST MISSION_REQUEST_INT
    MISSION_REQUEST_LIST ODOMETRY PARAM_REQUEST_LIST PARAM_REQUEST_READ PARAM_SET PARAM_VALUE PING REQUEST_DATA_STREAM
    SETUP_SIGNING SET_ATTITUDE_TARGET SET_GPS_GLOBAL_ORIGIN SET_MODE SET_POSITION_TARGET_LOCAL_NED STATUSTEXT SYSTEM_TIME
    SYS_STATUS TIMESYNC VFR_HUD VISION_POSITION_ESTIMATE
"""
# Enumerations whose values they use.
ENUMS = """
    ESTIMATOR_STATUS_FLAGS GPS_FIX_TYPE MAV_AUTOPILOT MAV_BATTERY_FUNCTION MAV_BATTERY_TYPE MAV_CMD MAV_COMPONENT
    MAV_DATA_STREAM MAV_FRAME MAV_LANDED_STATE MAV_MISSION_RESULT MAV_MISSION_TYPE MAV_MODE_FLAG MAV_PARAM_TYPE
    MAV_PROTOCOL_CAPABILITY MAV_RESULT MAV_SEVERITY MAV_STATE MAV_SYS_STATUS_SENSOR MAV_TYPE MAV_VTOL_STATE
"""

OTHERS_HEAD = '''"""Messages whose fields nothing reads. Written by `make mavlink`."""

# id, name, CRC_EXTRA, bytes of the payload, place of target_system in it (-1: it has none)
OTHERS: tuple[tuple[int, str, int, int, int], ...] = (
'''


def main(arguments: list[str]) -> int:
    """The exit code."""
    texts = generate()
    if "--check" not in arguments:
        for name, text in texts.items():
            (GENERATED / name).write_text(text, encoding="utf-8")
        return 0
    written = {name: (GENERATED / name).read_text(encoding="utf-8") for name in texts}
    if texts == written:
        return 0
    made_with, installed = (version_in(files["in_use.py"]) for files in (written, texts))
    if made_with != installed:
        print(f"the MAVLink dialect was made with pymavlink {made_with}; {installed} is installed: not compared")
        return 0
    print(f"{GENERATED} is not current; run `make mavlink`", file=sys.stderr)
    return 1


def generate() -> dict[str, str]:
    """The text of each generated file by its name."""
    parsed, wanted_messages, wanted_enums = _parse(SOURCE), set(MESSAGES.split()), set(ENUMS.split())
    messages = [message for xml in parsed for message in xml.message]
    used = [_without_texts(message) for message in messages if message.name in wanted_messages]
    others = [message for message in messages if message.name not in wanted_messages]
    enums = [_without_texts_of_enum(enum) for xml in parsed for enum in xml.enum if enum.name in wanted_enums]
    missing = (wanted_messages | wanted_enums) - {one.name for one in (*used, *enums)}
    assert not missing, f"not in {SOURCE}: {missing}"
    parsed[0].message, parsed[0].enum = used, enums
    return {"in_use.py": _in_use(parsed[0], messages), "others.py": _others(others)}


def version_in(text: str) -> str:
    """Version of pymavlink that made this text of in_use.py."""
    return text.rpartition(MADE_WITH)[2].strip()


def _parse(name: str) -> list[Any]:
    """This definition file and all that it includes, read by pymavlink, which prints what it finds odd in them."""
    folder = Path(pymavlink.dialects.v20.__file__).parent
    found: dict[str, Any] = {}
    waiting = [name]
    with contextlib.redirect_stdout(io.StringIO()):
        while waiting:
            if (name := waiting.pop(0)) not in found:
                found[name] = mavparse.MAVXML(str(folder / name), mavparse.PROTOCOL_2_0)
                waiting += found[name].include
        assert not mavparse.check_duplicates(list(found.values()))  # merges enumerations too
    return list(found.values())


def _without_texts(message: Any) -> Any:
    message.description = ""
    for field in message.fields:
        field.description = field.units = field.display = field.enum = ""
    return message


def _without_texts_of_enum(enum: Any) -> Any:
    for entry in enum.entry:
        entry.description, entry.param = "", []
    return enum


def _in_use(xml: Any, messages: list[Any]) -> str:
    """pymavlink's text with the ids of all messages and our checksum, without the methods that send one of each kind."""
    used = xml.message
    with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        path = Path(folder) / "in_use.py"
        mavgen_python.generate(str(path), [xml])
        text = path.read_text(encoding="utf-8")
    ids_of_used = _text_of(mavgen_python.generate_message_ids, used)
    for old, new in (
        (FASTCRC, CHECKSUM),
        (ids_of_used, _text_of(mavgen_python.generate_message_ids, messages)),
        (_text_of(mavgen_python.generate_methods, used), ""),
    ):
        assert text.count(old) == 1, f"pymavlink's generator does not write this any more: {old[:60]!r}"
        text = text.replace(old, new)
    return f"{text.strip()}\n\n{MADE_WITH}{pymavlink.__version__}\n"


def _text_of(write: Callable[[TextIO, list[Any]], None], messages: list[Any]) -> str:
    """What a part of pymavlink's generator writes for these messages."""
    text = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()):
        write(text, messages)
    return text.getvalue()


def _others(messages: list[Any]) -> str:
    rows = (
        (message.id, message.name, message.crc_extra, message.wire_length, _target_at(message))
        for message in sorted(messages, key=lambda one: one.id)
    )
    return OTHERS_HEAD + "".join(f"    {row!r},\n" for row in rows) + ")\n"


def _target_at(message: Any) -> int:
    return message.target_system_ofs if "target_system" in message.fieldnames else -1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
