"""The motion-capture system of a scenario in virtual time: what it measures of the stand-ins goes to their agents at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.types.peers import BodyPose
from sitl.flight.virtual_vehicle import VirtualAgent, VirtualStandIn
from sitl.vehicle.capture import CaptureSystem
from sitl.vehicle.config import StandIns
from sitl.vehicle.dynamics import ATTITUDE, POSITION

CAMERA_STEPS = 2  # from frame to frame: 125 Hz
SESSION = 1


class VirtualCameras:
    """They see all vehicles. `step` is called for each step of the world."""

    def __init__(
        self, stand_ins: Sequence[VirtualStandIn], agents: Mapping[int, VirtualAgent], settings: StandIns
    ) -> None:
        self._stand_ins, self._agents = stand_ins, agents
        self._system = CaptureSystem(settings.seed, settings.capture_faults)

    def step(self, number: int, now_s: float) -> None:
        """A frame of its poses, if one is due in this step, which ends now."""
        frame, rest = divmod(number, CAMERA_STEPS)
        if rest:
            return
        truths = {}
        for stand_in in self._stand_ins:
            x, y, z = stand_in.autopilot.quad.state[POSITION]
            qw, qx, qy, qz = stand_in.autopilot.quad.state[ATTITUDE]
            truths[stand_in.vehicle_id] = (x, y, z), (qw, qx, qy, qz)
        for vehicle_id, position_enu_m, quaternion, age_s in self._system.frame(now_s, truths):
            pose = BodyPose(SESSION, frame, now_s, position_enu_m, quaternion, age_s=age_s)
            self._agents[vehicle_id].take_pose(pose, now_s)
