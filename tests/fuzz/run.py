"""Decoders and whole agents under hostile input, in parallel, with a table of the results."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from textwrap import fill

from sitl.workers import LocalWorkers, all_results, report_progress
from tests.fuzz.decoders import Fuzzed, decoders, fuzz
from tests.fuzz.episode import Outcome, fly

EPISODE_TICKS = 3600  # about, of all vehicles
MOST_TICK_CPU_S = 0.02  # a period of 50 Hz
INPUTS_A_JOB, EPISODES_A_JOB = 250_000, 4

Job = tuple[str, int, int]
"""A decoder, the seed and the number of inputs; "" for episodes: the first seed and their number."""


def run_hostile(inputs: int, ticks: int, seed: int, out: Path | None) -> int:
    """The exit code: 1 where an invariant was broken."""
    jobs: list[Job] = [
        (name, seed + index, min(INPUTS_A_JOB, inputs - index * INPUTS_A_JOB))
        for name in decoders()
        for index in range(-(-inputs // INPUTS_A_JOB))
    ]
    episodes = -(-ticks // EPISODE_TICKS)
    jobs += [("", seed + at, min(EPISODES_A_JOB, episodes - at)) for at in range(0, episodes, EPISODES_A_JOB)]
    results = all_results(LocalWorkers(), work, jobs, _show)
    print(file=sys.stderr)
    text = table(results, seed)
    print(text)
    if out:
        out.write_text(text, encoding="utf-8")
    return 1 if any(result.failures or slow_ticks(result) for found in results for result in found) else 0


def work(job: Job) -> list[Fuzzed] | list[Outcome]:
    """One job, in a worker."""
    name, seed, count = job
    if name:
        return [fuzz(name, count, seed)]
    outcomes = []
    for index in range(count):
        outcome = fly(seed + index)
        if outcome.longest_tick_s > MOST_TICK_CPU_S:  # the machine may have been slow: the same episode again
            outcome = min(outcome, fly(seed + index), key=lambda flown: flown.longest_tick_s)
        outcomes.append(outcome)
        report_progress((index + 1) / count)
    return outcomes


def slow_ticks(result: Fuzzed | Outcome) -> list[str]:
    """The longest tick of an episode, where its work takes more than MOST_TICK_CPU_S of CPU time."""
    if isinstance(result, Fuzzed) or result.longest_tick_s <= MOST_TICK_CPU_S:
        return []
    return [f"a tick took {1e3 * result.longest_tick_s:.1f} ms of CPU time: {result.longest_tick}"]


def table(results: list[list[Fuzzed] | list[Outcome]], seed: int) -> str:
    """The results as Markdown."""
    fuzzed = [result for found in results for result in found if isinstance(result, Fuzzed)]
    outcomes = [result for found in results for result in found if isinstance(result, Outcome)]
    lines = [
        "# Hostile input: results",
        "",
        f"Written by `make hostile`, seed {seed}. [Wrong messages](wrong-messages.md) explains it.",
        "",
        "| decoder | inputs | decoded | CPU time per input | failures |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(result.name for result in fuzzed):
        of_it = [result for result in fuzzed if result.name == name]
        inputs, passed = sum(r.inputs for r in of_it), sum(r.passed for r in of_it)
        cpu_us = 1e6 * sum(r.cpu_s for r in of_it) / max(1, inputs)
        lines.append(f"| {name} | {inputs:,} | {passed:,} | {cpu_us:.1f} us | {sum(len(r.failures) for r in of_it)} |")
    phases: Counter[str] = sum((outcome.phases for outcome in outcomes), Counter())
    passed_all = sum((outcome.passed for outcome in outcomes), Counter[str]())
    ticks = sum(outcome.ticks for outcome in outcomes)
    mean_us = 1e6 * sum(outcome.tick_seconds for outcome in outcomes) / max(1, ticks)
    rows = {
        "episodes of three agents, and of a chain of six": " and ".join(
            f"{sum(outcome.vehicles == vehicles for outcome in outcomes):,}" for vehicles in (3, 6)
        ),
        "ticks of an agent": f"{ticks:,}",
        "hostile packets, commands, targets, traffic and telemetry that the decoders pass": ", ".join(
            f"{passed_all[kind]:,}" for kind in ("packet", "command", "target", "traffic", "telemetry")
        ),
        "ticks under hostile input in formation": f"{phases['formation']:,}",
        "exceptions, broken invariants and locks": f"{sum(len(outcome.failures) for outcome in outcomes)}",
        "mean and longest CPU time of a tick": (
            f"{mean_us:.0f} us, {1e3 * max((o.longest_tick_s for o in outcomes), default=0.0):.1f} ms"
        ),
        f"ticks above {1e3 * MOST_TICK_CPU_S:.0f} ms, of the longest of each episode": (
            f"{sum(len(slow_ticks(outcome)) for outcome in outcomes)}"
        ),
        "most objects in one agent's state": f"{max((o.most_objects for o in outcomes), default=0):,}",
    }
    lines += ["", "| whole agents | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())]
    failures = [f"- {r.name}: {text}" for r in fuzzed for text in r.failures]
    failures += [
        f"- seed {outcome.seed}: {text}" for outcome in outcomes for text in outcome.failures + slow_ticks(outcome)
    ]
    wrapped = [fill(text, 100, subsequent_indent="  ", break_long_words=False) for text in failures]
    return "\n".join([*lines, *([""] if failures else []), *wrapped]) + "\n"


def _show(share: float) -> None:
    print(f"\r{100.0 * share:5.1f} %", end="", file=sys.stderr, flush=True)
