"""All that can be said of the paper's figures 4 to 10 by flying: the one entry for the report."""

from __future__ import annotations

from sitl.paper.aggregation_claims import aggregation_claims
from sitl.paper.book import Book
from sitl.paper.claims import Claim
from sitl.paper.experiment_claims import experiment_claims
from sitl.paper.platoon_claims import platoon_claims
from sitl.paper.ring_claims import ring_claims


def flight_claims(book: Book) -> list[Claim]:
    """In the order of the figures."""
    return [*aggregation_claims(book), *platoon_claims(book), *experiment_claims(book), *ring_claims(book)]
