"""The autopilot's parameters by mavsdk: read by name, set and read again."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from mavsdk.plugins.param import Param, ParamError, ParamResult


class ParameterError(Exception):
    """A parameter that could not be set. str() says which and why."""


class Parameters:
    """Reads and sets one autopilot's parameters. Whether one is an integer is the autopilot's to say."""

    def __init__(self, system: Any) -> None:
        """`system` is a MavsdkBridge's."""
        self._param = Param(system)
        self._integers: dict[str, bool] = {}

    async def read_all(self, names: Iterable[str]) -> dict[str, float | None]:
        """Values by name; None for one that the autopilot does not answer."""
        return {name: await self.read(name) for name in names}

    async def read(self, name: str) -> float | None:
        """None after 3 s without an answer: an autopilot says nothing of a parameter that it does not have."""
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
        """Set a parameter that was read before, and read it again. Raises ParameterError."""
        integer = self._integers[name]
        try:
            if integer:
                await asyncio.to_thread(self._param.set_param_int, name, int(value))
            else:
                await asyncio.to_thread(self._param.set_param_float, name, value)
        except ParamError as error:
            word = error.result.name.lower().replace("_", " ")
            raise ParameterError(f"{name} could not be set to {value:g}: {word}") from error
        told = await self.read(name)
        if told is None or abs(told - value) > 1e-6:
            shown = "nothing" if told is None else f"{told:g}"
            raise ParameterError(f"{name} was set to {value:g}, but the autopilot says {shown}")

    def close(self) -> None:
        self._param.destroy()
