"""What Prometheus reads, parsed by Prometheus' own parser."""

from __future__ import annotations

import re
from math import inf

import pytest
import yaml
from msgspec.structs import replace
from prometheus_client.parser import text_string_to_metric_families

from common import ROOT
from companion.monitor.api import ReplayView, Snapshot
from companion.monitor.metrics import FLEET_MEASURES, SERVER_MEASURES, VEHICLE_MEASURES, exposition
from live_site import ALARM, FLEET, monitored_snapshot, monitored_vehicle

NAMES = {measure.name for measure in (*VEHICLE_MEASURES, *FLEET_MEASURES)} | set(SERVER_MEASURES)


def samples(of: Snapshot) -> dict[tuple[str, ...], float]:
    """(name, fleet, vehicle, value of a further label) -> value."""
    families = text_string_to_metric_families(exposition(of).decode())
    every = [sample for family in families for sample in family.samples]
    return {(s.name, *(s.labels[name] for name in sorted(s.labels, key=_rank))): s.value for s in every}


def _rank(label: str) -> int:
    return ("fleet", "vehicle").index(label) if label in ("fleet", "vehicle") else 2


def test_an_old_position_has_no_value() -> None:
    found = samples(monitored_snapshot(replace(monitored_vehicle(1), data_age_s=1.5)))
    assert ("companion_vehicle_altitude_meters", "platoon", "1") not in found
    assert ("companion_vehicle_speed_meters_per_second", "platoon", "1") not in found
    assert ("companion_vehicle_position_error_meters", "platoon", "1", "vertical") not in found


def test_a_vehicle_that_never_reported_is_down() -> None:
    found = samples(replace(monitored_snapshot(monitored_vehicle(1)), fleets=(replace(FLEET, missing_ids=(3,)),)))
    assert found["companion_vehicle_up", "platoon", "3"] == 0.0
    assert ("companion_vehicle_report_age_seconds", "platoon", "3") not in found


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (("companion_vehicle_up", "platoon", "1"), 1.0),
        (("companion_vehicle_battery_ratio", "platoon", "1"), 0.87),
        (("companion_vehicle_speed_meters_per_second", "platoon", "1"), 5.0),
        (("companion_vehicle_phase", "platoon", "1", "formation"), 1.0),
        (("companion_vehicle_phase", "platoon", "1", "land"), 0.0),
        (("companion_vehicle_flag", "platoon", "1", "TICK_LATE"), 1.0),
        (("companion_vehicle_flag", "platoon", "1", "LEADER_LOST"), 0.0),
        (("companion_vehicle_leader", "platoon", "1"), 1.0),
        (("companion_vehicle_position_error_meters", "platoon", "1", "vertical"), 0.7),
        (("companion_vehicle_tick_lateness_seconds", "platoon", "1", "0.99"), 0.0009),
        (("companion_vehicle_ticks_missed_total", "platoon", "1"), 3.0),
        (("companion_vehicle_rejected_total", "platoon", "1"), 7.0),
        (("companion_vehicle_cpu_ratio", "platoon", "1"), 0.14),
        (("companion_vehicle_memory_bytes", "platoon", "1"), 49e6),
        (("companion_vehicle_nearest_distance_meters", "platoon", "1"), 1.5),
        (("companion_vehicle_unsecured", "platoon", "1"), 0.0),
        (("companion_fleet_smallest_separation_meters", "platoon"), 1.5),
        (("companion_fleet_vehicles", "platoon"), 2.0),
        (("companion_monitor_alarms", "platoon", "critical"), 1.0),
        (("companion_monitor_unreachable_endpoints",), 1.0),
        (("companion_monitor_replay",), 0.0),
    ],
)
def test_values_have_the_units_of_their_names(key: tuple[str, ...], value: float) -> None:
    assert samples(monitored_snapshot(monitored_vehicle(1)))[key] == pytest.approx(value)


def test_a_silent_vehicle_has_its_age_and_nothing_else() -> None:
    read = samples(monitored_snapshot(monitored_vehicle(1), monitored_vehicle(2, silent=True, age_s=42.0)))
    of_silent = {key[0]: value for key, value in read.items() if key[1:3] == ("platoon", "2")}
    assert of_silent == {"companion_vehicle_up": 0.0, "companion_vehicle_report_age_seconds": 42.0}


def test_unknown_values_are_left_out() -> None:
    unknown = monitored_vehicle(
        1, battery_percent=None, data_age_s=None, position_error_m=None, nearest=None, error_to_slot_m=inf
    )
    names = {key[0] for key in samples(monitored_snapshot(unknown))}
    for name in (
        "battery_ratio", "data_age_seconds", "position_error_meters", "nearest_distance_meters", "slot_error_meters"
    ):  # fmt: skip
        assert f"companion_vehicle_{name}" not in names
    assert "companion_fleet_lambda_min" not in names


def test_no_foreign_text_becomes_a_label() -> None:
    foreign = 'evil"} 1\nup{x="'
    one = monitored_vehicle(
        1, phase=foreign, mode=foreign, formation=foreign, holder=foreign, last_event=foreign, landed=foreign
    )
    hostile = monitored_snapshot(
        one, monitored_vehicle(2, fleet=foreign), fleets=(FLEET, replace(FLEET, name=foreign)), operator=foreign
    )
    assert b"evil" not in exposition(hostile)
    assert {key[1] for key in samples(hostile) if len(key) > 1} == {"platoon"}
    assert {key[2] for key in samples(hostile) if key[0].startswith("companion_vehicle")} == {"1"}


def test_acknowledged_alarms_are_not_counted_and_a_replay_is_marked() -> None:
    read = samples(
        monitored_snapshot(alarms=(ALARM, replace(ALARM, acknowledged=True)), replay=ReplayView(0.0, 10.0, 5.0, 1.0))
    )
    assert read["companion_monitor_alarms", "platoon", "critical"] == 1.0
    assert read["companion_monitor_replay",] == 1.0


@pytest.mark.parametrize("name", sorted(NAMES))
def test_names_follow_the_conventions(name: str) -> None:
    assert re.fullmatch("companion_(vehicle|fleet|monitor)(_[a-z]+)+", name)
    assert f"# HELP {name} " in exposition(monitored_snapshot(monitored_vehicle(1))).decode()


def test_the_page_has_every_metric() -> None:
    assert set(re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/metrics.md").read_text(), re.MULTILINE)) == NAMES


def test_the_sample_rules_use_metrics_that_exist() -> None:
    (group,) = yaml.safe_load((ROOT / "deploy/prometheus/alerts.yaml").read_text())["groups"]
    for rule in group["rules"]:
        used = set(re.findall(r"companion_\w+", rule["expr"]))
        assert used, rule["alert"]
        assert used <= NAMES, rule["alert"]
        assert {"alert", "expr", "labels", "annotations"} <= rule.keys()
