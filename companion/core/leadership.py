"""Who leads: this vehicle's role and the epoch that it is of. A newer lead always wins, so two never both command for long."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from companion.types import MAX_EPOCH, MAX_EPOCHS_AHEAD, Lead, LeaderWord, Role, Term


class Leadership:
    """Epoch 0 has the fleet file's roles. `events` tells every change of the own role, until somebody takes it.

    The lead is taken by a command, or claimed by a successor when nobody is heard to have it. What is heard of a newer lead
    makes a follower, also of a leader that missed the command or was restarted: who leads in it knows that. Of either no more
    than MAX_EPOCHS_AHEAD at once is believed: one wrong number cannot use up all epochs that are left. What is heard is held
    to that in `core/peers.py`.

    Leads are in one order, by `term`: of two in one epoch the commanded one comes after a claimed one, and of two claims that
    of the better rank. No two vehicles have one rank, so a claimed term is one vehicle's alone.
    """

    def __init__(self, own_id: int, leaders: Iterable[int], may_lead: Collection[int]) -> None:
        """`leaders` and `may_lead` are the fleet file's."""
        self._own_id = own_id
        self._may_lead = frozenset(may_lead)
        self._obeyed = Lead(tuple(leaders), 0)
        self.term: Term = (0, 0)
        self.role = self._role_in(self._obeyed)
        self.events: list[str] = []

    @property
    def epoch(self) -> int:
        return self.term[0]

    @property
    def claim(self) -> int:
        """The rank that the lead was claimed with; 0 where it was commanded."""
        return -self.term[1]

    def obey(self, lead: Lead) -> tuple[bool, str]:
        """(accepted, why not or what happens now). The command of the epoch that it is in may come again."""
        if lead == self._obeyed and self.term == (lead.epoch, 0):
            return True, f"already {self.role} in epoch {self.epoch}"
        if refusal := self._refusal(lead):
            return False, f"lead: {refusal}"
        self._obeyed = lead
        self._enter((lead.epoch, 0), self._role_in(lead), "told so")
        return True, f"{self.role} in epoch {self.epoch}"

    def take(self, rank: int) -> None:
        """The lead of the next epoch, as the successor of this rank; `core/succession.py` says when."""
        if self.epoch < MAX_EPOCH:
            self._enter((self.epoch + 1, -rank), Role.LEADER, f"successor {rank} of a leader that is not heard")

    def hear(self, words: Iterable[LeaderWord | None]) -> None:
        """What peers pass on of their leaders."""
        newest = max([word.term for word in words if word is not None], default=self.term)
        if newest > self.term:
            self._enter(newest, Role.FOLLOWER, "heard of it")

    def _refusal(self, lead: Lead) -> str | None:
        strangers = sorted(set(lead.leaders) - self._may_lead)
        allowed = ", ".join(str(i) for i in sorted(self._may_lead))
        if not lead.leaders:
            return f"names nobody; expected some of {allowed}"
        if strangers:
            return f"vehicle {strangers[0]} is not one that may lead; expected some of {allowed}"
        # An epoch that was only heard of, or claimed, may still be commanded: this vehicle missed that when others were told.
        if lead.epoch < self.epoch or lead.epoch == self._obeyed.epoch:
            return f"epoch {lead.epoch} is not newer than {self.epoch}"
        if lead.epoch > min(self.epoch + MAX_EPOCHS_AHEAD, MAX_EPOCH):
            return f"epoch {lead.epoch} is too large; expected {self.epoch + 1}"
        return None

    def _role_in(self, lead: Lead) -> Role:
        return Role.LEADER if self._own_id in lead.leaders else Role.FOLLOWER

    def _enter(self, term: Term, role: Role, reason: str) -> None:
        if role is not self.role:
            self.events.append(f"{self.role} -> {role} in epoch {term[0]} ({reason})")
        self.term, self.role = term, role
