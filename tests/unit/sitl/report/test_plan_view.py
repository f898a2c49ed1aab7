"""Division of a flight into the panels of its plan view."""

from companion.types.commands import CommandName
from sitl.flight.scenario import TimelineStep
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import Formation
from sitl.report.plan_view import PlanPanel, panels_of
from sitl.report.summary import CommandGiven


def watched(*asked: tuple[float, TimelineStep]) -> FlightWatch:
    """A flight that began at 100 s, in formation from 110 s to 160 s."""
    watch = FlightWatch([1, 2], [1], 100.0)
    watch.formations = [Formation(110.0, 130.0, 110.0), Formation(140.0, 160.0, 110.0)]
    watch.commands = [
        CommandGiven(time_s=at_s, command=step.command, in_words=step.in_words(), vehicles=[1, 2], answered_in_s=0.02)
        for at_s, step in asked
    ]
    return watch


LAND, ARM, TAKEOFF = (
    TimelineStep(command=name, vehicles=(2,)) for name in (CommandName.LAND, CommandName.ARM, CommandName.TAKEOFF)
)


def test_a_formation_without_commands_is_one_panel() -> None:
    assert panels_of(watched((5.0, TimelineStep(command=CommandName.FORM)))) == [PlanPanel(110.0, 160.0, "form")]


def test_a_command_begins_a_panel_and_a_repeated_one_counts_once() -> None:
    panels = panels_of(watched((30.0, LAND), (30.5, LAND), (33.0, LAND)))
    assert panels == [PlanPanel(110.0, 130.0, "form"), PlanPanel(130.0, 160.0, "land 2")]


def test_commands_that_follow_soon_share_a_panel() -> None:
    panels = panels_of(watched((30.0, LAND), (40.0, ARM), (40.6, TAKEOFF)))
    assert [panel.command for panel in panels] == ["form", "land 2", "arm 2, takeoff 2"]
    assert [panel.start_s for panel in panels] == [110.0, 130.0, 140.0]
    assert panels[-1].end_s == 160.0


def test_the_command_that_ends_a_formation_has_no_panel() -> None:
    """Over a network a landing is answered some hundredths of a second after it was given."""
    assert [panel.command for panel in panels_of(watched((30.0, ARM), (59.9, LAND)))] == ["form", "arm 2"]


def test_only_the_last_panels_are_drawn_when_there_are_many() -> None:
    lead = [TimelineStep(command=CommandName.LEAD, leaders=(1 + k % 2,)) for k in range(12)]
    panels = panels_of(watched(*((11.0 + 4.0 * k, step) for k, step in enumerate(lead))))
    assert len(panels) == 9
    assert panels[-1].end_s == 160.0
