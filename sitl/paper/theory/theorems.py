"""All claims that are checked by computation, for the report."""

from __future__ import annotations

from sitl.paper.theory.algorithm1 import algorithm_1
from sitl.paper.theory.comparison import platoon, proposition_2_against_22, proposition_2_against_26
from sitl.paper.theory.convergence import proposition_1_and_corollary_1
from sitl.paper.theory.matrices import matrix_claims
from sitl.paper.theory.spectrum import corollary_2, lemma_1, lemma_1_converse, lemma_2, rows_of_g
from sitl.paper.theory.survey import take_survey
from sitl.report.claim import Claim, Progress, no_progress

# Share of the run time at which each stage ends.
SURVEYED, CONVERGED, COUNTED = 0.5, 0.8, 0.95


def theory_claims(full: bool = False, progress: Progress = no_progress) -> list[Claim]:
    """Every claim of sections 2 to 4 and on the printed matrices, in the order of the paper.

    `full` uses every graph of up to seven vertices instead of six, and ten times as many random graphs.
    """
    survey = take_survey(full, _part(progress, 0.0, SURVEYED))
    in_time = proposition_1_and_corollary_1(survey, _part(progress, SURVEYED, CONVERGED))
    algorithm = algorithm_1(survey, _part(progress, CONVERGED, COUNTED))
    claims = [
        rows_of_g(survey),
        algorithm,
        lemma_1(survey),
        lemma_1_converse(survey),
        *in_time,
        lemma_2(survey),
        corollary_2(survey),
        proposition_2_against_22(survey),
        proposition_2_against_26(survey),
        platoon(),
        *matrix_claims(),
    ]
    progress(1.0)
    return claims


def _part(progress: Progress, begin: float, end: float) -> Progress:
    """Progress of one stage as progress of all stages."""
    return lambda share: progress(begin + (end - begin) * share)
