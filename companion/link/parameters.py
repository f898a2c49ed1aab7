"""Autopilot parameters by mavsdk: read by name, set and read back."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from mavsdk.plugins.param import Param, ParamError, ParamResult


class ParameterError(Exception):
    """A parameter that could not be set. `str()` names it and the reason."""


class Parameters:
    """Reads and sets parameters of one autopilot. The autopilot reports which are integers."""

    def __init__(self, system: Any) -> None:
        """`system` is that of a MavsdkBridge."""
        self._param = Param(system)
        self._integers: dict[str, bool] = {}

    async def read_all(self, names: Iterable[str]) -> dict[str, float | None]:
        """Values by name; None for a parameter without an answer."""
        return {name: await self.read(name) for name in names}

    async def read(self, name: str) -> float | None:
        """The value, or None after 3 s without an answer: an autopilot does not answer for an unknown parameter."""
        try:
            value = float(await asyncio.to_thread(self._param.get_param_int, name))
            self._integers[name] = True
        except ParamError as error:
            if error.result is not ParamResult.WRONG_TYPE:
                return None
            return await self._read_float(name)
        return value

    async def _read_float(self, name: str) -> float | None:
        try:
            value = float(await asyncio.to_thread(self._param.get_param_float, name))
        except ParamError:
            return None
        self._integers[name] = False
        return value

    async def set(self, name: str, value: float) -> None:
        """Set a parameter that was read before, and read it back. Raises ParameterError."""
        integer = self._integers[name]
        try:
            if integer:
                await asyncio.to_thread(self._param.set_param_int, name, int(value))
            else:
                await asyncio.to_thread(self._param.set_param_float, name, value)
        except ParamError as error:
            reason = error.result.name.lower().replace("_", " ")
            raise ParameterError(f"{name} could not be set to {value:g}: {reason}") from error
        read_back = await self.read(name)
        if read_back is None or abs(read_back - value) > 1e-6:
            shown = "nothing" if read_back is None else f"{read_back:g}"
            raise ParameterError(f"{name} was set to {value:g}, but the autopilot reports {shown}")

    def close(self) -> None:
        self._param.destroy()
