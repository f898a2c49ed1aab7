"""Plot on the latency of section 5.2: distances of followers to their slots relative to the leader, on the figure 8."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from companion.config.fleet import LawName
from sitl.paper.book import Book, Entry
from sitl.paper.figures.platoon import DPI
from sitl.paper.flights import FlightSubject, Model
from sitl.paper.measures import behind_leader_m
from sitl.paper.topology import leaderships
from sitl.report.plots import LAW_TITLES, TIME_LABEL, dress, look, new_figure

LAWS: tuple[LawName, ...] = ("average_22", "weighted")
SHADES = {1: "#f4f4f4", 2: "#e2e8ee"}  # by leader


def save_latency(path: Path, book: Book) -> None:
    """One panel per law; the background shade shows the leader."""
    figure = new_figure(12.0, 6.8, "Square on the figure of eight: distance to the slot relative to the leader")
    for axes, law in zip(figure.subplots(2, 1, sharex=True, sharey=True), LAWS, strict=True):
        _draw(axes, book.one(FlightSubject.FIGURE_8, law, Model.FULL))
        axes.set_title(f"{LAW_TITLES[law]}, full quadrotor", fontsize=11)
        axes.set_ylabel("distance [m]")
    figure.axes[0].set_ylim(0.0, 1.12 * figure.axes[0].get_ylim()[1])  # room for the labels of the leader
    figure.axes[1].set_xlabel(TIME_LABEL)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=10, handlelength=3.5)
    figure.savefig(path, dpi=DPI)


def _draw(axes: Axes, entry: Entry) -> None:
    """A leader has no distance to itself, so its curve has a gap during its leadership."""
    flight, formation = entry.flight, entry.flight.formation
    times_s = formation.times_s()
    since_s = times_s - formation.start_s
    spans = leaderships(entry.flown)
    for index, vehicle_id in enumerate(sorted(flight.tracks)):
        distance_m = times_s * float("nan")
        for lead in spans:
            during = (times_s >= lead.from_s) & (times_s <= lead.to_s)
            if vehicle_id != lead.leader_id:
                distance_m[during] = behind_leader_m(flight, lead.leader_id, vehicle_id, times_s[during])
        axes.plot(since_s, distance_m, label=f"UAV {vehicle_id}", **look(index, 3 * times_s.size // 2))
    dress(axes, since_s)
    for lead in spans:
        from_s, to_s = lead.from_s - formation.start_s, lead.to_s - formation.start_s
        axes.axvspan(from_s, to_s, color=SHADES.get(lead.leader_id, "#ffffff"), zorder=0)
        axes.text((from_s + to_s) / 2, 0.95, f"leader: UAV {lead.leader_id}", transform=axes.get_xaxis_transform(),
                  ha="center", va="top", fontsize=9, color="#333333")  # fmt: skip
