"""What must agree between the machines of a cluster for identical results: code, versions and arithmetic."""

from __future__ import annotations

import math
import platform
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

import companion
import sitl

PACKAGES = ("numpy", "scipy", "msgspec", "distributed")
DIGITS = 12  # of the digest


@cache
def software() -> dict[str, str]:
    """Name and version of everything on this machine that results depend on."""
    return {
        "formation-companion": companion.__version__,
        "its source files": _sources(),
        "Python": platform.python_version(),
        **{package: _version(package) for package in PACKAGES},
        "arithmetic": _arithmetic(),
    }


def differences(wanted: dict[str, str], found: dict[str, str]) -> str:
    """What differs, such as "numpy 1.26.4 (here 2.4.6)", with commas between; "" where nothing does."""
    return ", ".join(
        f"{name} {found.get(name, 'unknown')} (here {wanted[name]})"
        for name in wanted
        if found.get(name) != wanted[name]
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _sources() -> str:
    """A digest: two checkouts of one version may hold different code."""
    digest = sha256()
    for package in (companion, sitl):
        assert package.__file__ is not None
        folder = Path(package.__file__).parent
        for file in sorted(folder.rglob("*.py")):
            digest.update(f"{folder.name}/{file.relative_to(folder)}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:DIGITS]


def _arithmetic() -> str:
    """A digest of computed values: numpy and BLAS choose their loops by the processor, and the last bits differ."""
    x = np.linspace(-20.0, 20.0, 4001)
    matrix = np.sin(np.arange(64.0)).reshape(8, 8)
    computed = [
        *(function(x) for function in (np.sin, np.cos, np.exp, np.arctan, np.tanh)),
        *(np.log(x * x + 1.0), np.arctan2(x, x[::-1]), np.hypot(x, x[::-1]), np.power(x * x, 0.3)),
        *(matrix @ matrix, np.linalg.eigvalsh(matrix @ matrix.T), np.linalg.solve(matrix + 8.0 * np.eye(8), matrix)),
        np.array([function(value) for function in (math.sin, math.exp, math.atan) for value in x.tolist()]),
    ]
    return sha256(b"".join(values.tobytes() for values in computed)).hexdigest()[:DIGITS]
