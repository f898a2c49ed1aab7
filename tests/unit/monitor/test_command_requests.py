"""A request of the page -> that of `companion fleet`, or one line that says what is wrong."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.reference import CircleReference
from companion.ground.commands import OperateError
from companion.monitor.api import CommandRequest
from companion.monitor.command_requests import ACTIONS, CHANGES, fleet_action
from tests.bench.monitor_load import steady_fleet

FLEET = steady_fleet("load", 3).fleet
CIRCLE = {"kind": "circle", "centre_enu_m": [0.0, 0.0, 10.0], "radius_m": 5.0, "period_s": 60.0}


def request(name: str, content: dict[str, Any] | None = None, ids: tuple[int, ...] = ()) -> CommandRequest:
    return CommandRequest("load", name, ids, content or {})


@pytest.mark.parametrize("name", sorted(set(ACTIONS) - set(CHANGES)))
def test_a_command_without_content_goes_to_the_vehicles_named(name: str) -> None:
    made = fleet_action(request(name, ids=(3, 1)), FLEET)
    assert (made.name, made.only) == (name, (3, 1))


def test_changes_have_their_content() -> None:
    assert fleet_action(request("leader", {"leader_ids": [2]}), FLEET).leaders == (2,)
    shape = fleet_action(request("formation", {"shape": "v", "spacing_m": 4, "heading_deg": 90}), FLEET).formation
    assert shape is not None
    assert (shape.shape, shape.spacing_m, shape.heading_deg, shape.scale) == ("v", 4, 90, 1.0)
    slots = {"1": [0, 0, 0], "2": [3, 0, 0], "3": [0, 3, 0]}
    given_slots = fleet_action(request("formation", {"slots_enu_m": slots}), FLEET).formation
    assert given_slots is not None
    assert given_slots.slots_enu_m == {1: (0, 0, 0), 2: (3, 0, 0), 3: (0, 3, 0)}
    reference = fleet_action(request("reference", CIRCLE, (1, 2, 3)), FLEET).reference
    assert reference is not None
    assert isinstance(reference.whole, CircleReference)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (CommandRequest("other", "hold"), "fleet: 'other' is not commanded here; expected 'load'"),
        (request("explode"), "name: 'explode' is no action; expected one of arm"),
        (request("admit"), "is no action"),
        (request("hold", ids=(7,)), "vehicle_ids: vehicle 7 is not in the fleet; expected some of 1, 2, 3"),
        (request("hold", {"shape": "v"}), "content: hold has none"),
        (request("leader", {}), "leader_ids"),
        (request("leader", {"leader_ids": []}), "leader_ids"),
        (request("leader", {"leader_ids": [9]}), "content.leader_ids: vehicle 9 is not in the fleet"),
        (request("leader", {"leader_ids": [1]}, (1,)), "leader is for the whole fleet"),
        (request("formation", {}), "content: is empty; expected shape"),
        (request("formation", {"shape": "star", "spacing_m": 3}), "star"),
        (request("formation", {"shape": "v"}), "content.spacing_m"),
        (request("formation", {"shape": "v", "spacing_m": -3}), "spacing_m"),
        (request("formation", {"shape": "v", "spacing_m": 3, "heading_deg": 1e3}), "heading_deg"),
        (request("formation", {"shape": "v", "spacing_m": 3, "slots_enu_m": {}}), "expected one of them"),
        (request("formation", {"slots_enu_m": {"1": [0, 0, 0]}}), "slots_enu_m.2: missing"),
        (request("formation", {"slots_enu_m": {"x": [0, 0, 0]}}), "slots_enu_m"),
        (request("formation", {"file": "/etc/passwd"}), "file"),
        (request("reference", {"kind": "spiral"}), "reference.kind"),
        (request("reference", {k: v for k, v in CIRCLE.items() if k != "radius_m"}), "reference.radius_m: missing"),
        (request("reference", CIRCLE | {"radius_m": float("nan")}), "reference.radius_m"),
    ],
)
def test_a_wrong_request_is_one_line(wrong: CommandRequest, words: str) -> None:
    with pytest.raises(OperateError) as raised:
        fleet_action(wrong, FLEET)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
keys = st.sampled_from(["shape", "spacing_m", "slots_enu_m", "leader_ids", "kind", "radius_m", "points_enu_m"])


@given(st.sampled_from(CHANGES), st.dictionaries(keys, json_values, max_size=5))
def test_any_content_is_a_request_or_one_line(name: str, content: dict[str, Any]) -> None:
    try:
        fleet_action(request(name, content), FLEET)
    except OperateError as error:
        assert "\n" not in str(error)
