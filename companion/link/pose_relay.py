"""Motion-capture poses to the autopilot: judged and passed on when they arrive, beside the ticks of the agent."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, radians
from typing import Protocol

from companion.config.fleet import VisionSettings
from companion.core.agent import Agent
from companion.core.estimation.poses import PoseJudge
from companion.mavlink.translator import pose_covariance
from companion.types.autopilot import Telemetry
from companion.types.peers import BodyPose

EARLY = 0.25  # of a period: frames come with jitter, and their rate is seldom a multiple of the one that is wanted


class PoseTaker(Protocol):
    """A link to an autopilot."""

    def pose(self, pose: BodyPose, measured_s: float, covariance: Sequence[float], resets: int) -> None:
        """Send a pose."""

    def keep(self, sample: Telemetry) -> None:
        """A sample for the next tick of the agent."""


class PoseRelay:
    """The poses of one vehicle. Its agent sees the verdict on each in the next tick."""

    def __init__(self, settings: VisionSettings, agent: Agent, link: PoseTaker) -> None:
        self._agent, self._link, self._judge = agent, link, PoseJudge()
        self._period_s, self._passed_s = 1.0 / settings.rate_hz, -inf
        self._covariance = pose_covariance(settings.position_error_m, radians(settings.angle_error_deg))

    def receive(self, pose: BodyPose, received_s: float) -> None:
        """A pose of this vehicle, at its arrival. A good one is passed on unless the last one was just now."""
        sample = self._judge.judge(received_s, pose, self._agent.perception.state, self._agent.others_enu_m)
        self._link.keep(sample)
        if not sample.fault and received_s - self._passed_s >= (1.0 - EARLY) * self._period_s:
            self._passed_s = received_s
            self._link.pose(pose, sample.measured_s, self._covariance, self._judge.resets)
