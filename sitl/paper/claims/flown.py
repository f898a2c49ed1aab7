"""All claims of the paper that are checked by flights."""

from __future__ import annotations

from sitl.paper.book import Book
from sitl.paper.claims.aggregation import aggregation_claims
from sitl.paper.claims.experiment import experiment_claims
from sitl.paper.claims.platoon import platoon_claims
from sitl.paper.claims.ring import ring_claims
from sitl.report.claim import Claim


def flight_claims(book: Book) -> list[Claim]:
    """In the order of the figures."""
    return [*aggregation_claims(book), *platoon_claims(book), *experiment_claims(book), *ring_claims(book)]
