"""Who leads: this vehicle's role and the epoch that it is of. A newer epoch always wins, so two never both command for long."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from companion.types import MAX_EPOCH, MAX_EPOCHS_AHEAD, Lead, LeaderWord, Role


class Leadership:
    """Epoch 0 has the fleet file's roles. `events` tells every change of the own role, until somebody takes it.

    The lead is only ever taken by a command. What is heard of a newer epoch makes a follower, also of a leader that missed the
    command or was restarted: who leads in that epoch was told so. Of either no more than MAX_EPOCHS_AHEAD at once is believed:
    one wrong number cannot use up all epochs that are left. What is heard is held to that in `core/peers.py`.
    """

    def __init__(self, own_id: int, leaders: Iterable[int], may_lead: Collection[int]) -> None:
        """`leaders` and `may_lead` are the fleet file's."""
        self._own_id = own_id
        self._may_lead = frozenset(may_lead)
        self._obeyed = Lead(tuple(leaders), 0)
        self.epoch = 0
        self.role = self._role_in(self._obeyed)
        self.events: list[str] = []

    def obey(self, lead: Lead) -> tuple[bool, str]:
        """(accepted, why not or what happens now). The command of the epoch that it is in may come again."""
        if lead == self._obeyed:
            return True, f"already {self.role} in epoch {self.epoch}"
        if refusal := self._refusal(lead):
            return False, f"lead: {refusal}"
        self._obeyed = lead
        self._enter(lead.epoch, self._role_in(lead), "told so")
        return True, f"{self.role} in epoch {self.epoch}"

    def hear(self, words: Iterable[LeaderWord | None]) -> None:
        """What peers pass on of their leaders."""
        newest = max([word.epoch for word in words if word is not None], default=0)
        if newest > self.epoch:
            self._enter(newest, Role.FOLLOWER, "heard of it")

    def _refusal(self, lead: Lead) -> str | None:
        strangers = sorted(set(lead.leaders) - self._may_lead)
        allowed = ", ".join(str(i) for i in sorted(self._may_lead))
        if not lead.leaders:
            return f"names nobody; expected some of {allowed}"
        if strangers:
            return f"vehicle {strangers[0]} is not one that may lead; expected some of {allowed}"
        # An epoch that was only heard of may still be commanded: this vehicle missed that when the others were told.
        if lead.epoch < self.epoch or lead.epoch == self._obeyed.epoch:
            return f"epoch {lead.epoch} is not newer than {self.epoch}"
        if lead.epoch > min(self.epoch + MAX_EPOCHS_AHEAD, MAX_EPOCH):
            return f"epoch {lead.epoch} is too large; expected {self.epoch + 1}"
        return None

    def _role_in(self, lead: Lead) -> Role:
        return Role.LEADER if self._own_id in lead.leaders else Role.FOLLOWER

    def _enter(self, epoch: int, role: Role, reason: str) -> None:
        if role is not self.role:
            self.events.append(f"{self.role} -> {role} in epoch {epoch} ({reason})")
        self.epoch, self.role = epoch, role
