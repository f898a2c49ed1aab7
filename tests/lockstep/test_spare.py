"""One vehicle of a column is dead: the operator gives the others new formations, and a waiting spare takes its slot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pytest

from common import ROOT
from companion.ground.answers import AnswerKind, TimedReply
from companion.ground.changes import FleetAction, FormationRequest, ReferenceRequest
from companion.ground.commands import OperatorCommands, wait_for
from companion.ground.goals import goal_of
from companion.types.commands import CommandName, Content
from companion.types.flight import FlightPhase
from companion.types.formation import FormationChange
from companion.types.status import Status
from companion.types.values import Vector3
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"
DEAD, SPARE = 4, 5
REST = (1, 2, 3)
DIES_S = 14.0
MAY_LEAD = (1, 2)
AHEAD = ReferenceRequest(None, {"kind": "waypoints"}, ([0.0, 0.0, 2.0], [6.0, 0.0, 2.0]))
ASIDE = ReferenceRequest(None, {"kind": "waypoints"}, ([0.0, 0.0, 2.0], [0.0, 8.0, 2.0]))
COLUMN = {i: (-2.0 * (i - 1), 0.0, 0.0) for i in range(1, 6)}
IN_ITS_PLACE = COLUMN | {SPARE: COLUMN[DEAD], DEAD: COLUMN[SPARE]}


class WithoutOne(CommandedFlight):
    """Vehicle 4 dies in formation. The agents in `restarts` start again later: they have never heard of it."""

    def __init__(self, *restarts: int) -> None:
        ends = [f"{{vehicle: {DEAD}, at_s: {DIES_S}}}"]
        ends += [f"{{vehicle: {i}, at_s: {DIES_S + 1.5}, restarts_after_s: 1.5}}" for i in restarts]
        super().__init__(SCENARIO, "fleet.when_one_leaves=keep_gap", f"agent_ends=[{','.join(ends)}]")
        assert self.lockstep.now_s() < DIES_S

    def reports(self) -> Mapping[int, Status]:
        gone = {DEAD} if self.lockstep.now_s() > DIES_S + 1.0 else set()
        return {i: status for i, status in self.lockstep.newest().items() if i not in gone}

    def order(self, action: FleetAction, *asked: int) -> Content:
        """Give it as `companion fleet` does, and wait until these vehicles, which get it, have done it. Its content."""
        session = Session(self)
        commands = OperatorCommands(session, self.scenario.fleet, 0.2, self.lockstep)
        sent = commands.send(action)
        accepted = {i for i, outcome in sent.outcomes.items() if outcome.kind is AnswerKind.ACCEPTED}
        assert accepted == set(asked), sent.outcomes
        assert sent.content is not None
        goal = goal_of(sent.name, sent.content, sent.running)
        assert goal is not None
        outcomes = {i: sent.outcomes[i] for i in accepted}
        ended = wait_for(goal, outcomes, session.newest, 60.0, lambda _: None, self.lockstep)
        assert all(outcome.good for outcome in ended.values()), ended
        self.go_on(0.1)
        return sent.content

    def change(self, request: FormationRequest) -> dict[int, Vector3]:
        """The slots of the formation that all but the dead one fly now."""
        content = self.order(FleetAction("formation", formation=request), *REST, SPARE)
        assert isinstance(content, FormationChange)
        assert content.absent == (DEAD,)
        return dict(content.slots_enu_m)


class Session:
    """The fleet as its operator reaches it: without a status of a vehicle that is silent."""

    operator = "sitl-run"

    def __init__(self, flight: WithoutOne) -> None:
        self._flight = flight

    def newest(self) -> Mapping[int, Status]:
        return self._flight.reports()

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        return self._flight.lockstep.ask(vehicle_ids, name, timeout_s, content)

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        return self._flight.lockstep.check(vehicle_ids, name, timeout_s, content)


def slots_as(slots_enu_m: Mapping[int, Vector3]) -> FormationRequest:
    return FormationRequest(None, None, None, 0.0, 1.0, slots_enu_m)


@pytest.mark.long
def test_the_rest_flies_on_and_a_spare_takes_the_slot_of_the_dead_one() -> None:
    flight = WithoutOne()
    flight.land(SPARE)
    flight.go_on(DIES_S + 2.0 - flight.lockstep.now_s())
    began_s = flight.lockstep.now_s()
    del flight.newest[DEAD]  # its autopilot holds where it was
    flight.change(FormationRequest(None, None, None, 0.0, 1.2))
    assert {flight.newest[i].phase for i in REST} == {FlightPhase.FORMATION}
    flight.order(FleetAction("reference", reference=ASIDE), *MAY_LEAD)

    flight.change(slots_as(IN_ITS_PLACE))
    flight.take_off_again(SPARE)
    flight.give(CommandName.FORM, SPARE)
    flight.until(SPARE, FlightPhase.FORMATION)
    flight.go_on(16.0)
    assert flight.newest[SPARE].formation.slot.position_enu_m == COLUMN[DEAD]
    assert flight.errors_m().keys() == {*REST, SPARE}
    assert max(flight.errors_m().values()) < 0.2

    slots = flight.change(FormationRequest(None, None, None, 0.0, 1.5))  # its own slot in the fleet file is taken now
    assert slots[SPARE] == (-9.0, 0.0, 0.0)
    flight.change(FormationRequest("line", None, 2.5, 90.0, 1.0))
    assert max(flight.errors_m().values()) < 0.2
    assert flight.smallest_m(began_s) > 1.0


def test_a_vehicle_whose_agent_started_after_the_death_keeps_off_the_dead_one() -> None:
    """The others tell it where the dead one was. Its way into formation leads straight through that place."""
    flight = WithoutOne(SPARE)
    flight.land(SPARE)
    flight.go_on(DIES_S + 4.0 - flight.lockstep.now_s())
    began_s = flight.lockstep.now_s()
    del flight.newest[DEAD]
    flight.order(FleetAction("reference", reference=AHEAD), *MAY_LEAD)
    flight.take_off_again(SPARE)
    flight.give(CommandName.FORM, SPARE)
    flight.until(SPARE, FlightPhase.FORMATION)
    flight.go_on(9.0)
    assert flight.smallest_m(began_s) > 1.0
