"""Leadership: this vehicle's role and its term. The newest term wins, so two leaders in different terms never last."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from math import inf

from companion.types.autopilot import VehicleState, in_air
from companion.types.commands import EPOCHS_AHEAD, MAX_EPOCH, NUMBERS_AHEAD, Lead
from companion.types.flight import LEAD_CHANGES_IN, Flight, FlightPhase, Role
from companion.types.formation import LeaderBeacon, Term
from companion.types.notices import Answer, Code, Notice, accept

UNCONFIRMED_S = 0.3  # after this time a received term ends, unless its leader is known to be alive
RISES_AFTER_S = 0.15  # after a few beacons at once: a stamp that rises later is that of a leader that is alive
REFUTED = 8  # remembered beacons of terms without a leader


class Leadership:
    """Epoch 0 has the roles of the fleet file. Changes of the own role are returned as events.

    A vehicle becomes leader by command, or as successor of a lost leader. A newer term received from a peer makes it a
    follower, even a leader that missed the command or restarted: the leader of that term knows its role. A received term
    without a leader that is alive ends after UNCONFIRMED_S, with the role before. Only a leader raises stamps: a beacon that
    vehicles pass to each other proves nothing, however young it is on its way. A command may raise the epoch by
    NUMBERS_AHEAD; `core/consensus/stage.py` allows peer packets less. A command may also name an epoch so far below
    that peers of the epoch left are not believed: the own one was wrong, and so one command reaches every vehicle.

    Terms are ordered: within an epoch a command beats a claim, and a better rank beats a worse one. Ranks are unique, so a
    claimed term belongs to one vehicle.
    """

    def __init__(self, own_id: int, leaders: Iterable[int], may_lead: Collection[int]) -> None:
        """`leaders` and `may_lead` are ids of the fleet file."""
        self._own_id = own_id
        self._may_lead = frozenset(may_lead)
        self._commanded = Lead(tuple(leaders), 0)
        self.term: Term = (0, 0)
        self.role = self._role_in(self._commanded)
        # A received term that needs more beacons: since when, and term and role before it; None once it is settled
        self.unconfirmed: tuple[float, Term, Role] | None = None
        self._stamps: dict[int, int] = {}  # largest of each leader of an unconfirmed term
        self._refuted: tuple[tuple[Term, int], ...] = ()  # terms and stamps that others may still pass on

    @property
    def epoch(self) -> int:
        return self.term[0]

    @property
    def claim_rank(self) -> int:
        """The successor's rank of a claimed term; 0 for a commanded or configured one."""
        return -self.term[1]

    def command(self, lead: Lead) -> tuple[Answer, tuple[Notice, ...]]:
        """((accepted, reason), events). A repeated command of the present term is accepted again."""
        answer = self.judge(lead)
        if answer.notice.code is not Code.ROLE_CHANGED:
            return answer, ()
        self._commanded = lead
        return answer, self._enter((lead.epoch, 0), self._role_in(lead), "commanded")

    def judge(self, lead: Lead) -> Answer:
        """The answer to this command. It changes nothing."""
        if lead == self._commanded and self.term == (lead.epoch, 0):
            return accept(Code.ALREADY_DONE, f"already {self.role} in epoch {self.epoch}")
        if refusal := self._refusal(lead):
            return Answer(False, refusal.about("lead"))
        return accept(Code.ROLE_CHANGED, f"{self._role_in(lead)} in epoch {lead.epoch}")

    def claim(self, rank: int) -> tuple[Notice, ...]:
        """Become leader of the next epoch as the successor of this rank; `Succession` decides when."""
        if self.epoch >= MAX_EPOCH:
            return ()
        return self._enter((self.epoch + 1, -rank), Role.LEADER, f"successor {rank} of a lost leader")

    def receive(self, now_s: float, beacons: Iterable[LeaderBeacon | None]) -> tuple[Notice, ...]:
        """Enter the newest term in the leader beacons of peers, until `settle` decides on it."""
        new = [b for b in beacons if b is not None and b.term > self.term and (b.term, b.stamp) not in self._refuted]
        if not new:
            return ()
        newest = max(new, key=lambda beacon: (beacon.term, beacon.stamp))
        term, role = self.unconfirmed[1:] if self.unconfirmed else (self.term, self.role)
        events = self._enter(newest.term, Role.FOLLOWER, "reported by a peer")
        self.unconfirmed, self._stamps = (now_s, term, role), {newest.leader_id: newest.stamp}
        self._refute(newest.term)
        return events

    def settle(self, now_s: float, beacons: Iterable[LeaderBeacon]) -> tuple[Notice, ...]:
        """Keep a received term once a stamp rises in these beacons of peers; else return to the term before."""
        if self.unconfirmed is None:
            return ()
        since_s, term, role = self.unconfirmed
        rises = [self._rises(beacon) for beacon in beacons if beacon.term == self.term]
        if any(rises) and now_s - since_s >= RISES_AFTER_S:
            self.unconfirmed = None
        if self.unconfirmed is None or now_s - since_s <= UNCONFIRMED_S:
            return ()
        self._refute(self.term)
        return self._enter(term, role, f"no leader of epoch {self.epoch}")

    def _rises(self, beacon: LeaderBeacon) -> bool:
        """Whether the stamp of this leader is larger than all of its before. Several leaders of a term have a clock each."""
        before = self._stamps.get(beacon.leader_id)
        if beacon.leader_id == self._own_id or (before is not None and beacon.stamp <= before):
            return False
        self._stamps[beacon.leader_id] = beacon.stamp
        return before is not None

    def _refute(self, term: Term) -> None:
        """Ignore the newest beacons of this term from now on: they enter it once."""
        refuted = [(term, stamp) for stamp in self._stamps.values() if (term, stamp) not in self._refuted]
        self._refuted = (*self._refuted, *refuted)[-REFUTED:]

    def _refusal(self, lead: Lead) -> Notice | None:
        not_allowed = sorted(set(lead.leaders) - self._may_lead)
        allowed = ", ".join(str(i) for i in sorted(self._may_lead))
        if not lead.leaders:
            return Notice(Code.NO_LEADER_NAMED, f"names no vehicle; expected some of {allowed}")
        if not_allowed:
            text = f"vehicle {not_allowed[0]} may not lead; expected some of {allowed}"
            return Notice(Code.NOT_A_LEADER, text)
        # A term known from peers, or claimed, may still be commanded: this vehicle missed the command that the others received.
        missed = lead.epoch == self.epoch != self._commanded.epoch
        if self.epoch - EPOCHS_AHEAD <= lead.epoch <= self.epoch and not missed:
            return Notice(Code.EPOCH_TOO_OLD, f"epoch {lead.epoch} is not newer than {self.epoch}")
        if lead.epoch > min(self.epoch + NUMBERS_AHEAD, MAX_EPOCH):
            text = f"epoch {lead.epoch} is too large; expected {self.epoch + 1}"
            return Notice(Code.EPOCH_TOO_LARGE, text)
        return None

    def _role_in(self, lead: Lead) -> Role:
        return Role.LEADER if self._own_id in lead.leaders else Role.FOLLOWER

    def _enter(self, term: Term, role: Role, reason: str) -> tuple[Notice, ...]:
        before, self.term, self.role, self.unconfirmed = self.role, term, role, None
        if role is before:
            return ()
        return (Notice(Code.ROLE_CHANGED, f"{before} -> {role} in epoch {term[0]} ({reason})"),)


def refusal_of_lead(flight: Flight, vehicle: VehicleState) -> Notice | None:
    """The reason why leadership cannot change now; None where it can.

    In formation it changes in flight, in hold and on the ground before the next formation. A vehicle that climbs, lands or
    is flown by its pilot takes no part; it receives the new epoch from its peers.
    """
    if flight.phase in LEAD_CHANGES_IN or (flight.phase is FlightPhase.OBSERVE and not in_air(vehicle)):
        return None
    text = f"lead is not possible in phase {flight.phase}, only in formation, in hold or on the ground"
    return Notice(Code.WRONG_PHASE, text)


TURN_S = 0.3  # longer than a claim needs to reach the next successor; otherwise the better rank wins later
RETURN_S = 0.4  # the leader may leave a term without a leader later than this vehicle, and its beacon is on the way for as long


class Succession:
    """Loss of the leader: how long formation continues, and which successor becomes leader when.

    Beacons get lost or arrive late, so a leader with a stale beacon need not be dead. A delay of less than one turn changes
    nothing. Claims of vehicles that do not receive each other are ordered by their terms.

    The successor of rank k becomes leader k turns after the beacon was lost. All vehicles stop waiting two turns after the last
    successor's, which may have noticed the loss later; without successors, or without a neighbour in formation, after one turn,
    before any successor's turn. After a new term is received, waiting starts again, as its beacon is on the way.
    After the return from a term without a leader to one in which a leader was alive it lasts RETURN_S longer.
    """

    def __init__(self, own_id: int, successors: Sequence[int]) -> None:
        """`successors` are the ids of the fleet file, best rank first."""
        self._rank = successors.index(own_id) + 1 if own_id in successors else 0
        self._turns = len(successors) + 2 if successors else 1
        self._term: Term = (0, 0)
        self._led_s = -inf
        self._led = False  # whether the term had a leader in the last tick
        self._returns_s = 0.0  # extra wait after a return from the present term to an older one

    def awaits(self, now_s: float, term: Term, led: bool, with_neighbours: bool, last_led_s: float = -inf) -> bool:
        """Whether a leader is known, or may still appear. `with_neighbours`: a neighbour flies in formation.

        A tick in which a leader is known in the same term as in the tick before needs no call: `last_led_s` is the newest one.
        """
        if last_led_s > self._led_s:
            self._led_s = last_led_s
        if term > self._term:
            self._returns_s = RETURN_S if self._led else 0.0
        if led or term != self._term:
            led_s = now_s + self._returns_s if term < self._term else now_s
            if led_s > self._led_s:
                self._led_s = led_s
        self._term, self._led = term, led
        return now_s - self._led_s <= TURN_S * (self._turns if with_neighbours else 1)

    def rank_in_turn(self, now_s: float) -> int:
        """This vehicle's rank among the successors from its turn on; before it, and for all others, 0."""
        return self._rank if now_s - self._led_s > TURN_S * self._rank else 0
