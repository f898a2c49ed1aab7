"""Claims on convergence: Proposition 1 and Corollary 1, from the eigenvalues of the matrix of eq. 19."""

from __future__ import annotations

import numpy as np

from companion.core.consensus.law import PAPER_GAINS, Gains
from companion.stability.arrays import FloatArray
from companion.stability.interaction import mode_figures
from sitl.paper.theory.graphs import described
from sitl.paper.theory.survey import GraphSurvey
from sitl.report.claim import Claim, ClaimVerdict, Progress, no_progress

OTHER_GAINS = (Gains(1.0, 2.0), Gains(1.0, 4.0))  # critically damped at lambda = 1 and at lambda = 0.25
PROPORTIONAL = 1e-6  # relative tolerance; a double eigenvalue of eq. 19 is precise to the square root of rounding
LARGEST_LAMBDA = 3.0  # Corollary 2


def abscissa_1_s(interaction: FloatArray, gains: Gains) -> float:
    """Largest real part of the eigenvalues of A_c (eq. 19) [1/s]; the origin of eq. 18 is stable where it is negative."""
    n = len(interaction)
    below = [-gains.position_1_s2 * interaction, -gains.velocity_1_s * interaction]
    closed_loop = np.block([[np.zeros((n, n)), np.eye(n)], below])
    return float(np.linalg.eigvals(closed_loop).real.max())


def proposition_1_and_corollary_1(survey: GraphSurvey, progress: Progress = no_progress) -> list[Claim]:
    """Both claims, from the spectral abscissas of the same matrices."""
    all_gains = (PAPER_GAINS, *OTHER_GAINS)
    pairs = survey.all
    abscissas = np.zeros((len(pairs), len(all_gains)))
    for index, spectra in enumerate(pairs):
        abscissas[index] = [abscissa_1_s(spectra.interaction, gains) for gains in all_gains]
        if index % 100 == 0:
            progress(index / len(pairs))
    return [_proposition_1(survey, abscissas), _corollary_1(survey, abscissas)]


def _proposition_1(survey: GraphSurvey, abscissas: FloatArray) -> Claim:
    """Negative abscissas [pair, gains], and the bound of eq. 20, a step of the proof."""
    positive = all(spectra.lambda_min > 0.0 for spectra in survey.all)
    worst = float(abscissas.max())
    beyond = {
        _name(gains): sum(
            1
            for spectra, abscissa in zip(survey.all, abscissas[:, column], strict=True)
            if abscissa > -mode_figures(gains, spectra.lambda_min).rate_1_s + PROPORTIONAL
        )
        for column, gains in enumerate((PAPER_GAINS, *OTHER_GAINS))
    }
    broken = ", ".join(f"{count} pairs with K = {name}" for name, count in beyond.items() if count)
    return Claim(
        id="proposition-1",
        where="Proposition 1",
        claim="the origin of the error dynamics, eq. 18, is asymptotically stable if the smallest eigenvalue of G is positive",
        paper="every eigenvalue of eq. 19 left of the bound of eq. 20",
        ideal=f"spectral abscissa of eq. 19 at most {worst:.3g} 1/s with {len(abscissas[0])} sets of gains, on "
        f"{survey.extent()}",
        full="-",
        verdict=ClaimVerdict.HOLDS if positive and worst < 0.0 else ClaimVerdict.FAILS,
        remark=f"the bound of eq. 20 itself is exceeded on {broken}: the slowest mode may be an overdamped one of a larger "
        "eigenvalue"
        if broken
        else "the bound of eq. 20 is never exceeded",
        measured=survey.counts()
        | {f"largest_abscissa_1_s_{_key(name)}": float(abscissas[:, i].max()) for i, name in enumerate(beyond)}
        | {f"pairs_beyond_eq_20_{_key(name)}": float(count) for name, count in beyond.items()},
    )


def _corollary_1(survey: GraphSurvey, abscissas: FloatArray) -> Claim:
    """Rate / (k2/2 lambda_min), which is 1 where the corollary holds, and its limit lambda = 4 k1/k2^2."""
    shares = {
        _name(gains): np.array(
            [
                -abscissa / (gains.velocity_1_s / 2.0 * spectra.lambda_min)
                for spectra, abscissa in zip(survey.all, abscissas[:, column], strict=True)
            ]
        )
        for column, gains in enumerate((PAPER_GAINS, *OTHER_GAINS))
    }
    paper, *others = shares
    off = {name: int((np.abs(share - 1.0) > PROPORTIONAL).sum()) for name, share in shares.items()}
    limits = {_name(gains): limit_of_proportion(gains) for gains in (PAPER_GAINS, *OTHER_GAINS)}
    worst_name, worst_at = min(
        ((name, int(shares[name].round(6).argmin())) for name in others), key=lambda at: shares[at[0]][at[1]]
    )
    worst_share = float(shares[worst_name][worst_at])
    broken = "; ".join(f"K = {name} beyond lambda = {limits[name]:g} on {off[name]} pairs" for name in others)
    always = f", so always, for lambda <= {LARGEST_LAMBDA:g}" if limits[paper] > LARGEST_LAMBDA else ""
    verdict = (
        ClaimVerdict.FAILS
        if off[paper]
        else ClaimVerdict.CONDITION
        if any(off[name] for name in others)
        else ClaimVerdict.HOLDS
    )
    return Claim(
        id="corollary-1",
        where="Corollary 1",
        claim="for given gains the convergence speed is proportional to the smallest eigenvalue of G",
        paper="rate proportional to lambda_min",
        ideal=f"rate = {PAPER_GAINS.velocity_1_s / 2.0:g} lambda_min within {np.abs(shares[paper] - 1.0).max():.0e} with the "
        f"paper's gains, on {survey.extent()}",
        full="-",
        verdict=verdict,
        remark=f"rate = (k2/2) lambda_min while k2^2 lambda < 4 k1 for every eigenvalue: lambda < {limits[paper]:.3f} with the "
        f"paper's gains{always}. With other gains it is limited: {broken}; the smallest ratio is {worst_share:.3f}, with "
        f"K = {worst_name} on {described(survey.all[worst_at].pair)}. This is the asymptotic rate; G is not normal, so errors "
        "may grow before they decay",
        measured=survey.counts()
        | {f"largest_deviation_{_key(name)}": float(np.abs(share - 1.0).max()) for name, share in shares.items()}
        | {f"pairs_not_proportional_{_key(name)}": float(count) for name, count in off.items()}
        | {f"lambda_limit_{_key(name)}": limit for name, limit in limits.items()},
    )


def limit_of_proportion(gains: Gains) -> float:
    """4 k1 / k2^2: modes of larger eigenvalues are overdamped, with a rate below (k2/2) lambda."""
    return 4.0 * gains.position_1_s2 / gains.velocity_1_s**2


def _name(gains: Gains) -> str:
    return f"({gains.position_1_s2:g}, {gains.velocity_1_s:g})"


def _key(name: str) -> str:
    """The gains in the name of a measured figure: K_1.39_1.2."""
    return "K_" + name.strip("()").replace(", ", "_")
