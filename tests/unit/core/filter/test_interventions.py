from companion.core.filter.filter import ENDS_AFTER_S, Interventions
from companion.types.notices import Code
from companion.types.status import NearestVehicle, SeparationReport

CHANGED = SeparationReport(NearestVehicle("2", 1.1, 1.2), 2.0)
QUIET = SeparationReport(NearestVehicle("2", 1.5, 1.2))


def test_one_event_at_the_beginning_of_an_intervention_that_flickers() -> None:
    events = Interventions()
    seen = [events.step(0.02 * k, CHANGED if k % 3 else QUIET) for k in range(1, 200)]
    assert [notice.code for notices in seen for notice in notices] == [Code.SEPARATION_INTERVENES]


def test_another_event_after_a_pause() -> None:
    events = Interventions()
    assert events.step(1.0, CHANGED)
    assert not events.step(1.0 + ENDS_AFTER_S, CHANGED)
    assert events.step(10.0, CHANGED)


def test_a_vehicle_alone_reports_the_fence_and_obstacles_that_change_its_flight() -> None:
    (notice,) = Interventions().step(1.0, SeparationReport(None, 2.0))
    assert "obstacles and fence changes the acceleration by 2.0 m/s^2" in notice.text
