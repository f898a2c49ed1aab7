"""Law files with one defect each, as sources: what `companion law check`, a configuration and a flight make of them."""

from __future__ import annotations

from pathlib import Path

HEAD = "from companion.laws import Law\nfrom companion.laws.cooperative import Cooperative\n\n"
ACCELERATION = "    def acceleration(self, own, neighbours, reference):\n"
FLOWN = "        return Cooperative().acceleration(own, neighbours, reference)\n"
COUNTS = "    def remember(self, own, neighbours, reference):\n        return ((own.memory[0][0] + 1.0, 0.0, 0.0),)\n"
LATER = "        if own.memory[0][0] > 150.0 and own.slot_enu_m[0] < {west_of_m}:\n            {defect}\n"


def law(body: str, before: str = "", memory: int = 0) -> str:
    """The source of a law with this `acceleration`."""
    return f"{before}{HEAD}class Bad(Law, frozen=True):\n    memory = {memory}\n\n{ACCELERATION}{body}"


def fails_later(defect: str, west_of_m: float = 1000.0) -> str:
    """A law that is `cooperative` for 3 s of formation flight, and then, in slots that far west, does this."""
    return law(LATER.format(defect=defect, west_of_m=west_of_m) + FLOWN, memory=1) + f"\n{COUNTS}"


BAD_LAWS = {
    "raises": law("        return (1.0 / len(neighbours[5:]), 0.0, 0.0)\n"),
    "not_a_number": law("        return (float('nan'), 0.0, 0.0)\n"),
    "huge": law("        return (1e9, 0.0, 0.0)\n"),
    "sleeps": law("        sleep(0.01)\n" + FLOWN, "from time import sleep\n"),
    "imports_sockets": law(FLOWN, "import socket\n"),
    "absolute": law("        return tuple(-x - v for x, v in zip(own.position_enu_m, own.velocity_enu_m_s))\n"),
    "hidden_state": law(
        "        KEPT.append(own)\n        x, y, z = Cooperative().acceleration(own, neighbours, reference)\n"
        "        return (x + 0.001 * len(KEPT), y, z)\n",
        "KEPT = []\n",
    ),
}


def write_law(folder: Path, name: str, source: str) -> Path:
    """The file of a law, in a folder that only its owner can write."""
    folder.chmod(0o755)
    path = folder / f"{name}.py"
    path.write_text(source, encoding="utf-8")
    path.chmod(0o644)
    return path
