"""Trees of files like those of real companion computers, for the checks of the board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PI_4 = {
    "proc/device-tree/model": "Raspberry Pi 4 Model B Rev 1.5\0",
    "proc/cmdline": "coherent_pool=1M 8250.nr_uarts=0 console=tty1 root=PARTUUID=5b2a-02 rootfstype=ext4 rootwait",
    "proc/mounts": "/dev/mmcblk0p2 / ext4 rw,noatime 0 0\nproc /proc proc rw,relatime 0 0",
    "proc/sys/kernel/osrelease": "6.6.51+rpt-rpi-v8",
    "sys/class/hwmon/hwmon0/name": "cpu_thermal",
    "sys/class/hwmon/hwmon1/name": "rpi_volt",
    "sys/class/hwmon/hwmon1/in0_lcrit_alarm": "0",
    "sys/class/thermal/thermal_zone0/temp": "48686",
    "sys/class/tty/ttyAMA0/uartclk": "48000000",
    "sys/class/net/wlan0/wireless/placeholder": "",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "run/systemd/timesync/synchronized": "",
}
LINKS = {"dev/serial0": "ttyAMA0", "sys/class/tty/ttyAMA0/device/driver": "../../bus/amba/drivers/uart-pl011"}
OUTPUTS = {"power_save wlan0": "Power save: off", "get_throttled": "throttled=0x0"}


def board_tree(root: Path, changes: Mapping[str, str | None], links: Mapping[str, str] = LINKS) -> Path:
    """The files of a Raspberry Pi 4 that is ready, with some changed or, by None, missing."""
    for path, text in (PI_4 | dict(changes)).items():
        if text is not None:
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text + "\n", encoding="utf-8")
    for path, target in links.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).symlink_to(target)
    return root
